// Several planes: each pixel shows the shadow of the plane that is visible there.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "render/shadow/casters/caster.hpp"
#include "support/plane_coverage.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::receivers_test {
namespace {

using test::box;
using test::RenderedImage;
using test::ring;
using test::SceneBuilder;
using test::ShapeBuilder;
using test::Studio;

constexpr int kSide = 320;

CameraModel undistorted_camera() {
  return test::camera_of(kSide, kSide, 400.0);
}
CameraModel distorted_camera() {
  return test::distorted_camera(kSide, 400.0);
}
PoseEstimate slanted() {
  return test::tracked(test::look_at({0.35, -0.55, 0.4}, {0.0, 0.05, 0.06}));
}
Frame white() {
  return test::plain_frame(kSide, kSide, 255);
}

// An unbounded table with a left wall and a back wall. The back wall hides the table behind it.
SceneBuilder room() {
  SceneBuilder builder;
  const auto wall = [&](const char* name, const Eigen::Vector3d& normal,
                        const Eigen::Vector3d& point, std::vector<Eigen::Vector2d> outline) {
    ScenePlane& plane = builder.scene().planes.emplace_back();
    plane.name = name;
    plane.normal = normal;
    plane.point = point;
    plane.outline = std::move(outline);
  };
  wall("back", {0, -1, 0}, {0, 0.12, 0},
       {{-0.15, -0.02}, {0.15, -0.02}, {0.15, 0.12}, {-0.15, 0.12}});
  wall("left", {1, 0, 0}, {-0.15, 0, 0}, {{-0.12, 0}, {0.12, 0}, {0.12, 0.2}, {-0.12, 0.2}});
  ShadowNode& node = builder.scene().shadows[0];
  node.technique = ShadowTechnique::walls;
  node.walls = {1, 2};
  builder.add(ring(), test::at(0.0, 0.02, 0.09, {1, 0.3, 0}, 0.9));
  builder.add(box(0.06, 0.06, 0.06), test::at(0.02, 0.21, 0.03));  // behind the back wall
  builder.add(box(0.1, 0.03, 0.03), test::at(-0.12, 0.1, 0.03, {0, 0, 1}, 0.5));  // in the corner
  return builder;
}

// Returns the index of the plane that is visible at a pixel, or -1. Writes the visible point in
// plane coordinates to `point`.
int visible_plane(const Scene& scene, const CameraModel& camera, const CameraPose& pose, int x,
                  int y, Eigen::Vector3d& point) {
  const auto ray = camera.unproject({static_cast<double>(x), static_cast<double>(y)});
  if (!ray) return -1;
  const Eigen::Vector3d direction = pose.rotation() * *ray;
  int visible = -1;
  double nearest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < scene.planes.size(); ++i) {
    const ScenePlane& plane = scene.planes[i];
    const PlaneFrame frame = PlaneFrame::make(plane.normal, plane.point);
    if (frame.height(pose.translation()) <= 0.0) continue;
    const double t = -frame.height(pose.translation()) / frame.n.dot(direction);
    if (!(t > 0.0) || t >= nearest) continue;
    const Eigen::Vector3d p = frame.to_plane(pose.translation() + t * direction);
    if (!plane.outline.empty()) {  // the outline is a rectangle
      const Eigen::Vector2d low = plane.outline[0];
      const Eigen::Vector2d high = plane.outline[2];
      if ((p.head<2>().array() < low.array()).any() || (p.head<2>().array() > high.array()).any()) {
        continue;
      }
    }
    nearest = t;
    visible = static_cast<int>(i);
    point = p;
  }
  return visible;
}

// The orthogonal shadow of the scene's casters on one of its planes.
class SimpleShadow {
 public:
  SimpleShadow(const Scene& scene, std::size_t plane) {
    const ScenePlane& receiver = scene.planes[plane];
    const PlaneFrame frame = PlaneFrame::make(receiver.normal, receiver.point);
    for (const int caster : scene.shadows[0].casters) {
      const SceneObject& object = scene.objects[static_cast<std::size_t>(caster)];
      const ShadowMesh mesh = make_shadow_mesh(*object.model);
      const ShadowKernels none{frame.n, mesh.positions, {}};
      const auto triangles =
          orthogonal_triangles(place_caster(mesh, none, object.placement, frame), mesh.indices);
      triangles_.insert(triangles_.end(), triangles.begin(), triangles.end());
    }
  }
  [[nodiscard]] bool at(const Eigen::Vector3d& p) const {
    return test::covers(triangles_, p.head<2>());
  }

 private:
  std::vector<PlanePoint> triangles_;
};

class SeveralPlanes : public testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(Lenses, SeveralPlanes, testing::Bool(), [](const auto& instance) {
  return std::string(instance.param ? "distorted" : "undistorted");
});

TEST_P(SeveralPlanes, ShowShadowOfVisiblePlaneInEachPixel) {
  const CameraModel camera = GetParam() ? distorted_camera() : undistorted_camera();
  Studio studio(room().build(), camera);
  PlanOptions without_panes;
  without_panes.walls = false;
  const FramePlan plan = studio.plan(slanted(), without_panes);
  EXPECT_EQ(plan.receivers.size(), 3U);
  const RenderedImage image = studio.draw_shadows(white(), plan);
  // Each pixel is darkened once, also where planes meet.
  const int dark = static_cast<int>(std::lround(255.0 * std::pow(0.4, 1.0 / 2.2)));
  std::vector<int> shadow_pixels(3);
  std::vector<SimpleShadow> shadows;
  for (std::size_t i = 0; i < shadow_pixels.size(); ++i) shadows.emplace_back(studio.scene(), i);
  Scene table = studio.scene();
  table.planes.resize(1);
  int differing = 0;
  int hidden = 0;  // pixels of the table's shadow that the wall hides
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      Eigen::Vector3d p;
      const int plane = visible_plane(studio.scene(), camera, slanted().T_table_camera, x, y, p);
      const bool shadow = plane >= 0 && shadows[static_cast<std::size_t>(plane)].at(p);
      if (shadow) ++shadow_pixels[static_cast<std::size_t>(plane)];
      differing += image.red(x, y) != (shadow ? dark : 255) ? 1 : 0;
      ASSERT_TRUE(image.red(x, y) == dark || image.red(x, y) == 255) << x << " " << y;
      if (plane == 1) {
        const int below = visible_plane(table, camera, slanted().T_table_camera, x, y, p);
        hidden += below == 0 && shadows[0].at(p) ? 1 : 0;
      }
    }
  }
  for (std::size_t i = 0; i < shadow_pixels.size(); ++i) EXPECT_GT(shadow_pixels[i], 500) << i;
  EXPECT_GT(hidden, 300) << "the wall must hide a part of the table's shadow";
  EXPECT_LE(differing, 90) << "pixels away from edges differ";
}

TEST(ReceiverPlanes, DrawSameFrameInAnyOrderAndWithSkipping) {
  Scene scene = room().scene();
  const auto draw = [&](bool skip) {
    Studio studio(std::make_shared<const Scene>(scene), distorted_camera());
    PlanOptions options;
    options.skip = skip;
    options.walls = false;  // a wall in `planes` has no pane
    return studio.draw(white(), studio.plan(slanted(), options));
  };
  const RenderedImage first = draw(true);
  EXPECT_EQ(draw(false), first);
  scene.shadows[0].walls = {2, 1};
  EXPECT_EQ(draw(true), first);
  scene.shadows[0].planes = {2, 0};
  scene.shadows[0].walls = {1};
  EXPECT_EQ(draw(true), first);
}

// A plane out of view must not change the shadow on the other plane.
TEST(ReceiverPlanes, IgnorePlaneOutOfView) {
  SceneBuilder builder = room();
  builder.scene().planes[1].point.y() = 60.0;
  builder.scene().planes[2].point.x() = -60.0;
  Studio with(builder.build(), undistorted_camera());
  builder.scene().shadows[0].walls.clear();
  Studio without(builder.build(), undistorted_camera());
  const RenderedImage a = with.draw_shadows(white(), with.plan(slanted()));
  const RenderedImage b = without.draw_shadows(white(), without.plan(slanted()));
  EXPECT_EQ(a, b);
}

TEST(DefaultWalls, StandAtFarEdgesOfCasterPaths) {
  SceneBuilder builder;
  builder.add(box(0.02, 0.02, 0.02), test::at(0.1, -0.1, 0.05));
  Keyframe start;
  Keyframe end;
  end.time_s = 2.0;
  end.placement.position = {-0.3, 0.25, 0.1};
  builder.scene().objects[0].animation.keyframes = {start, end};
  builder.scene().objects[0].animation.interpolation = Animation::Interpolation::linear;
  builder.scene().objects[0].animation.loop = false;
  add_default_walls(builder.scene(), builder.scene().shadows[0]);
  ASSERT_EQ(builder.scene().planes.size(), 3U);
  EXPECT_EQ(builder.scene().shadows[0].walls, (std::vector<int>{1, 2}));
  const double r = 0.01 * std::sqrt(3.0);
  EXPECT_NEAR(builder.scene().planes[1].point.y(), 0.15 + r, 1e-6);
  EXPECT_NEAR(builder.scene().planes[2].point.x(), -0.2 - r, 1e-6);
  EXPECT_NEAR(builder.scene().planes[1].outline[2].y(), 0.15 + r, 1e-6);
  EXPECT_NEAR(builder.scene().planes[1].outline[2].x(), 0.15 + r, 1e-6);
  // A node with a vertical plane gets no default walls.
  builder.scene().shadows[0].planes = {0, 1};
  builder.scene().shadows[0].walls.clear();
  add_default_walls(builder.scene(), builder.scene().shadows[0]);
  EXPECT_TRUE(builder.scene().shadows[0].walls.empty());
}

}  // namespace
}  // namespace penumbra::receivers_test
