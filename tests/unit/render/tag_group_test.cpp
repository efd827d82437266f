// Objects and planes that move with a tag group.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <numbers>
#include <vector>

#include "render/frame_plan.hpp"
#include "render/scene/shadow_events.hpp"
#include "support/shadow_triples.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/techniques.hpp"

namespace penumbra {
namespace tag_group_test {
namespace {

using test::RenderedImage;
using test::Studio;

constexpr int kWidth = 320;
constexpr int kHeight = 240;

std::shared_ptr<const Model> box(double side) {
  test::ShapeBuilder shape;
  shape.box(-side / 2, -side / 2, -side / 2, side / 2, side / 2, side / 2);
  return test::finished(shape.build(), glm::vec4(0.8F, 0.3F, 0.1F, 1.0F));
}

GroupPose placed(const Eigen::Vector3d& position, double turn_rad = 0.0,
                 const Eigen::Vector3d& axis = Eigen::Vector3d::UnitZ()) {
  return {Eigen::Quaterniond(Eigen::AngleAxisd(turn_rad, axis.normalized())), position};
}
std::vector<GroupEstimate> seen(const std::string& name, const GroupPose& pose,
                                TrackStatus status = TrackStatus::tracked) {
  std::vector<GroupEstimate> groups(1);
  groups[0].name = name;
  groups[0].status = status;
  groups[0].T_table_group = pose;
  return groups;
}

// A box over the table, in front of a wall that may be attached to a tag group.
constexpr int kWall = 1;
test::SceneBuilder before_a_wall(bool tied = true) {
  test::SceneBuilder builder;
  builder.add(box(0.07), test::at(0.0, 0.05, 0.08, {1, 0, 0}, 0.3));
  ScenePlane& wall = builder.scene().planes.emplace_back();
  wall.name = "wall";
  wall.normal = {0, -1, 0};
  wall.point = {0, 0.2, 0.1};
  wall.outline = {{-0.2, -0.1}, {0.01, -0.1}, {0.01, 0.12}, {-0.2, 0.12}};
  if (tied) wall.tag_group = "wall";
  SceneLight& lamp = builder.scene().lights.emplace_back();
  lamp.name = "lamp";
  lamp.position = {0.02, -0.4, 0.2};
  lamp.intensity = 4.0;
  ShadowNode& node = builder.scene().shadows[0];
  node.planes = {0, kWall};
  node.lights = {0};
  return builder;
}

PoseEstimate viewer(double x = 0.1) {
  return test::tracked(test::look_at({x, -0.45, 0.4}, {0.0, 0.08, 0.05}));
}
CameraModel camera() {
  return test::camera_of(kWidth, kHeight, 300.0);
}

FramePlan plan_of(const Scene& scene, const std::vector<GroupEstimate>& groups,
                  const PlanOptions& options = {}, const PoseEstimate& pose = viewer()) {
  return plan_frame(scene, evaluate_scene(scene, 0.0, groups), pose, camera(), options);
}
int differing(const RenderedImage& a, const RenderedImage& b) {
  int count = 0;
  for (std::size_t i = 0; i < a.rgba.size(); i += 4)
    count += std::abs(int{a.rgba[i]} - int{b.rgba[i]}) > 3 ? 1 : 0;
  return count;
}

TEST(TagGroup, MovesAttachedObjectsWithGroup) {
  test::SceneBuilder builder = before_a_wall();
  builder.scene().objects[0].tag_group = "prop";
  const int child = builder.add(box(0.01), test::at(0.1, 0.0, 0.0));
  builder.scene().objects[static_cast<std::size_t>(child)].parent = 0;
  const int free = builder.add(box(0.01), test::at(0.1, 0.0, 0.0));
  const Scene& scene = builder.scene();
  const GroupPose T = placed({0.3, -0.1, 0.02}, 0.7, {0.2, 0.3, 1.0});
  std::vector<GroupEstimate> groups = seen("prop", T);
  groups.push_back(seen("wall", placed({0.0, 0.05, 0.0}, 0.2)).front());
  const SceneState state = evaluate_scene(scene, 0.0, groups);
  const SceneState rest = evaluate_scene(scene, 0.0);
  for (const Eigen::Vector3d& p : {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(0.1, -0.2, 0.3)}) {
    for (const int i : {0, child}) {
      const auto index = static_cast<std::size_t>(i);
      EXPECT_LT((state.objects[index] * p - T * (rest.objects[index] * p)).norm(), 1e-12);
      EXPECT_EQ(opacity_of(state, i), 1.0);
      EXPECT_EQ(opacity_of(rest, i), 0.0) << "the prop's position is unknown";
    }
    EXPECT_EQ(state.objects[static_cast<std::size_t>(free)] * p,
              rest.objects[static_cast<std::size_t>(free)] * p);
  }
  EXPECT_EQ(opacity_of(rest, free), 1.0);
  const PlaneFrame was = PlaneFrame::make(scene.planes[kWall].normal, scene.planes[kWall].point);
  const PlaneFrame& is = state.planes[kWall].frame;
  const GroupPose& W = groups[1].T_table_group;
  EXPECT_LT((is.lift(0.1, 0.2) - W * was.lift(0.1, 0.2)).norm(), 1e-12)
      << "the plane's axes rotate with the group";
  EXPECT_LT((is.n - W.rotation() * was.n).norm(), 1e-12);
  EXPECT_EQ(state.planes[kWall].opacity, 1.0);
  EXPECT_EQ(rest.planes[kWall].opacity, 0.0);
  EXPECT_EQ(rest.planes[0].opacity, 1.0);
}

TEST(TagGroup, HidesObjectsOfInvisibleGroup) {
  test::SceneBuilder builder = before_a_wall();
  builder.scene().objects[0].tag_group = "prop";
  builder.add(box(0.02), test::at(0.05, 0.05, 0.05));
  for (const ShadowTechnique technique : test::techniques_without({ShadowTechnique::none})) {
    PlanOptions options;
    options.technique = technique;
    for (const bool skip : {true, false}) {
      options.skip = skip;
      const FramePlan plan = plan_of(builder.scene(), {}, options);
      ASSERT_EQ(plan.objects.size(), 1U);
      EXPECT_EQ(plan.objects[0].object, 1);
      ASSERT_EQ(plan.receivers.size(), 1U);
      EXPECT_EQ(plan.receivers[0].plane, 0);
      for (const ShadowDraw& draw : plan.shadows) {
        EXPECT_EQ(draw.plane, 0);
        EXPECT_EQ(draw.object, 1);
      }
      for (const HardShadowDraw& draw : plan.hard_shadows) {
        EXPECT_EQ(draw.plane, 0);
        EXPECT_EQ(draw.object, 1);
      }
      for (const ShadowVolumeDraw& draw : plan.volumes) EXPECT_EQ(draw.object, 1);
      int reported = 0;
      for (const SkippedPass& skipped : plan.skipped)
        reported += key_of(skipped.reason) == "group_not_seen";
      EXPECT_EQ(reported, 2);
    }
  }
  for (const auto& groups :
       {seen("prop", placed({0, 0, 0}), TrackStatus::lost),
        seen("prop", placed({std::nan(""), 0, 0})), seen("another", placed({0, 0, 0}))}) {
    EXPECT_EQ(plan_of(builder.scene(), groups).objects.size(), 1U);
  }
}

TEST(TagGroup, FadesUncertainOrCoastingGroup) {
  test::SceneBuilder builder = before_a_wall();
  builder.scene().objects[0].tag_group = "wall";
  builder.add(box(0.02), test::at(0.05, 0.05, 0.05));
  std::vector<GroupEstimate> groups = seen("wall", placed({0, 0, 0}), TrackStatus::uncertain);
  const auto check = [&](float table, float wall, const PoseEstimate& pose) {
    const FramePlan plan = plan_of(builder.scene(), groups, {}, pose);
    ASSERT_EQ(plan.receivers.size(), 2U);
    EXPECT_FLOAT_EQ(plan.receivers[0].opacity, table);
    EXPECT_FLOAT_EQ(plan.receivers[1].opacity, wall);
    ASSERT_EQ(plan.objects.size(), 2U);
    EXPECT_FLOAT_EQ(plan.objects[0].opacity, wall);
    EXPECT_FLOAT_EQ(plan.objects[1].opacity, table);
    for (const ShadowDraw& draw : plan.shadows) {
      EXPECT_FLOAT_EQ(draw.opacity, draw.object == 0 || draw.plane == kWall ? wall : table);
    }
  };
  check(1.0F, 0.5F, viewer());
  groups[0].status = TrackStatus::held;
  groups[0].age_s = 0.25 * kHoldSeconds;
  check(1.0F, 0.75F, viewer());
  groups[0].held_from = TrackStatus::uncertain;
  check(1.0F, 0.375F, viewer());
  PoseEstimate doubtful = viewer();
  doubtful.status = TrackStatus::uncertain;
  groups[0].held_from = TrackStatus::tracked;
  check(0.5F, 0.5F, doubtful);
  groups[0].age_s = kHoldSeconds;
  EXPECT_EQ(plan_of(builder.scene(), groups).receivers.size(), 1U);
}

// A wall moved by its group must give the same frame as a scene whose wall is at that pose.
TEST(TagGroup, CastsShadowOnMovedWall) {
  const Eigen::Vector3d shift(0.02, 0.06, -0.01);
  test::SceneBuilder there = before_a_wall(false);
  there.scene().planes[kWall].point += shift;
  test::SceneBuilder unmoved = before_a_wall(false);
  Studio tied(before_a_wall().build(), camera());
  Studio fixed(there.build(), camera());
  Studio old(unmoved.build(), camera());
  const Frame frame = test::plain_frame(kWidth, kHeight, 190);
  for (const ShadowTechnique technique :
       test::techniques_without({ShadowTechnique::none, ShadowTechnique::volume})) {
    SCOPED_TRACE(std::string(to_string(technique)));
    PlanOptions options;
    options.technique = technique;
    const auto groups = seen("wall", placed(shift));
    const RenderedImage a = tied.draw(frame, plan_of(tied.scene(), groups, options));
    const RenderedImage b = fixed.draw(frame, plan_of(fixed.scene(), {}, options));
    const RenderedImage c = old.draw(frame, plan_of(old.scene(), {}, options));
    EXPECT_EQ(a, b);
    EXPECT_GT(differing(a, c), 40) << "the frame must depend on the wall's position";
  }
}

// If a wall rotates about its normal by 90 degrees, so does its outline.
TEST(TagGroup, RotatesOutlineWithWall) {
  test::SceneBuilder turned = before_a_wall(false);
  ScenePlane& wall = turned.scene().planes[kWall];
  const PlaneFrame frame = PlaneFrame::make(wall.normal, wall.point);
  const Eigen::Quaterniond R(Eigen::AngleAxisd(0.5 * std::numbers::pi, frame.n));
  for (Eigen::Vector2d& corner : wall.outline) {
    const Eigen::Vector3d p = R * (corner.x() * frame.e1 + corner.y() * frame.e2);
    corner = {frame.e1.dot(p), frame.e2.dot(p)};
  }
  test::SceneBuilder unturned = before_a_wall(false);
  Studio tied(before_a_wall().build(), camera());
  Studio fixed(turned.build(), camera());
  Studio old(unturned.build(), camera());
  const Frame video = test::plain_frame(kWidth, kHeight, 190);
  for (const ShadowTechnique technique : {ShadowTechnique::simple, ShadowTechnique::hard}) {
    PlanOptions options;
    options.technique = technique;
    const auto groups = seen("wall", GroupPose(R, Eigen::Vector3d(frame.q - R * frame.q)));
    const RenderedImage a = tied.draw(video, plan_of(tied.scene(), groups, options));
    const RenderedImage b = fixed.draw(video, plan_of(fixed.scene(), {}, options));
    const RenderedImage c = old.draw(video, plan_of(old.scene(), {}, options));
    EXPECT_LT(differing(a, b), 10);
    EXPECT_GT(differing(a, c), 40);
  }
}

// In one frame, each object is drawn with the opacity of its group.
TEST(TagGroup, DrawsFaintAndSolidObjectsTogether) {
  test::SceneBuilder builder;
  builder.scene().shadows.clear();
  builder.add(box(0.06), test::at(-0.1, 0.0, 0.03), false);
  builder.add(box(0.06), test::at(0.1, 0.0, 0.03), false);
  builder.scene().objects[1].tag_group = "prop";
  Studio studio(builder.build(), camera());
  const Frame frame = test::plain_frame(kWidth, kHeight, 40);
  const auto at = [&](TrackStatus status) {
    return studio.draw(frame, plan_of(studio.scene(), seen("prop", placed({0, 0, 0}), status)));
  };
  const RenderedImage solid = at(TrackStatus::tracked);
  const RenderedImage faint = at(TrackStatus::uncertain);
  const RenderedImage none = at(TrackStatus::lost);
  int same = 0;
  int between = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const int s = solid.red(x, y);
      const int f = faint.red(x, y);
      const int n = none.red(x, y);
      EXPECT_NEAR(f, 0.5 * (s + n), 1.5);
      same += s == n && s != 40 ? 1 : 0;
      between += std::abs(s - n) > 20 ? 1 : 0;
    }
  }
  EXPECT_GT(same, 500) << "the object on the table must not fade";
  EXPECT_GT(between, 500);
}

// Tests the reuse of docs/shadows.md#own-frame for a moving plane instead of a moving object.
TEST(TagGroup, RecomputesOnlyShadowsOfMovedPlane) {
  Studio studio(before_a_wall().build(), camera());
  const Frame frame = test::plain_frame(kWidth, kHeight, 190);
  const PlaneFrame wall =
      PlaneFrame::make(studio.scene().planes[kWall].normal, studio.scene().planes[kWall].point);
  for (const ShadowTechnique technique :
       test::techniques_without({ShadowTechnique::none, ShadowTechnique::volume})) {
    SCOPED_TRACE(std::string(to_string(technique)));
    PlanOptions options;
    options.technique = technique;
    options.layers = LayerDrawing::direct;  // a sliding shadow would need a new mask
    const auto draw = [&](const GroupPose& pose, double eye_x) {
      studio.draw(frame, plan_of(studio.scene(), seen("wall", pose), options, viewer(eye_x)));
      return studio.stats();
    };
    const GroupPose start = placed({0, 0, 0});
    EXPECT_EQ(draw(start, 0.1)[Counter::triples_recomputed], 2);
    const CompositeStats camera_only = draw(start, 0.15);
    EXPECT_EQ(camera_only[Counter::reprojections], 2);
    EXPECT_EQ(camera_only[Counter::triples_recomputed], 0);
    EXPECT_EQ(camera_only[Counter::shadow_vertices], 0);
    const CompositeStats away = draw(placed({0, 0.01, 0}), 0.15);
    EXPECT_EQ(away[Counter::triples_recomputed], 1) << "the shadow on the table is reused";
    EXPECT_EQ(away[Counter::reprojections], 1);
    if (technique == ShadowTechnique::hard) continue;  // its light does not move with the plane
    const Eigen::Vector3d along = 0.03 * wall.e1 - 0.01 * wall.e2;
    const CompositeStats slid = draw(placed(Eigen::Vector3d(0, 0.01, 0) + along), 0.15);
    EXPECT_EQ(slid[Counter::reprojections], 2) << "the plane moves along itself";
    EXPECT_EQ(slid[Counter::triples_recomputed], 0);
    EXPECT_EQ(slid[Counter::shadow_vertices], 0);
    EXPECT_EQ(slid[Counter::kernel_generations], 0);
    const CompositeStats tilted = draw(placed({0, 0.02, 0}, 0.2), 0.15);
    EXPECT_EQ(tilted[Counter::triples_recomputed], 1);
  }
}

TEST(TagGroup, ReportsMovedPlaneAsEvent) {
  const auto scene = before_a_wall().build();
  const auto state = [&](const std::vector<GroupEstimate>& groups) {
    return evaluate_scene(*scene, 0.0, groups);
  };
  const SceneState a = state(seen("wall", placed({0, 0, 0})));
  const SceneState b = state(seen("wall", placed({0, 0.01, 0})));
  EXPECT_TRUE(shadow_events(a, a).empty());
  const auto events = shadow_events(a, b);
  EXPECT_EQ(events, (std::vector<ShadowEvent>{{ShadowEventKind::plane_moved, kWall}}));
  EXPECT_TRUE(shadow_events(state({}), state({})).empty());
  const auto triples = test::affected_triples(*scene, scene->shadows[0], events);
  EXPECT_EQ(triples, (std::vector<test::ShadowTriple>{{0, kWall, 0}}));
  EXPECT_EQ(kShadowEventNames[static_cast<std::size_t>(ShadowEventKind::plane_moved)],
            "plane_moved");
}

}  // namespace
}  // namespace tag_group_test
}  // namespace penumbra
