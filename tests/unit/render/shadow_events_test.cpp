// Events of the shadow node and the recomputations they cause, animated lights, and the sun.
#include "render/scene/shadow_events.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "render/scene/sun.hpp"
#include "support/shadow_triples.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra::shadow_node_test {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr int kSide = 200;

std::shared_ptr<const Model> box() {
  test::ShapeBuilder shape;
  shape.box(-0.03, -0.03, -0.03, 0.03, 0.03, 0.03);
  return test::finished(shape.build(), glm::vec4(1.0F));
}

// Three casters, two planes and two lights; tests animate the first light and the first object.
test::SceneBuilder moving_scene() {
  test::SceneBuilder builder;
  for (int i = 0; i < 3; ++i) builder.add(box(), test::at(0.1 * i - 0.1, 0.0, 0.1));
  for (int i = 0; i < 2; ++i) {
    SceneLight& light = builder.scene().lights.emplace_back();
    light.name = i == 0 ? "lamp" : "window";
    light.position = {-0.3 + 0.4 * i, 0.2, 0.8};
    builder.scene().shadows[0].lights.push_back(i);
  }
  ScenePlane& wall = builder.scene().planes.emplace_back();
  wall.name = "wall";
  wall.normal = {0, -1, 0};
  wall.point = {0, 0.2, 0};
  builder.scene().shadows[0].planes = {0, 1};
  builder.scene().shadows[0].technique = ShadowTechnique::hard;
  builder.scene().lights[1].position.y() = 0.1;
  builder.scene().lights[0].position.y() = 0.1;
  return builder;
}
Animation along(const Eigen::Vector3d& to, double until_s) {
  Animation animation;
  Keyframe end;
  end.time_s = until_s;
  end.placement.position = to;
  animation.keyframes = {Keyframe(), end};
  animation.interpolation = Animation::Interpolation::linear;
  animation.loop = false;
  return animation;
}

TEST(ShadowEvents, ListChangedObjectsAndLights) {
  SceneState before;
  before.objects.resize(3);
  before.lights.resize(2);
  EXPECT_TRUE(shadow_events(before, before).empty()) << "equal states have no events";
  SceneState now = before;
  now.time_s = 1.0;
  now.lights[1].position.x() += 0.1;
  now.objects[0].position.z() += 0.1;
  now.objects[0].scale = 2.0;
  now.objects[2].rotation = Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitX());
  EXPECT_EQ(shadow_events(before, now),
            (std::vector<ShadowEvent>{{ShadowEventKind::light_moved, 1},
                                      {ShadowEventKind::object_moved, 0},
                                      {ShadowEventKind::object_resized, 0},
                                      {ShadowEventKind::object_rotated, 2}}));
  now = before;
  now.lights[0].color *= 0.5;
  EXPECT_TRUE(shadow_events(before, now).empty()) << "dimming a light does not change its shadow";
}

TEST(ShadowEvents, RecomputeOnlyAffectedTriples) {
  test::SceneBuilder builder = moving_scene();
  builder.scene().lights[0].animation = along({0.2, 0.0, 0.0}, 1.0);     // until 1 s
  builder.scene().objects[0].animation = along({0.0, 0.02, 0.05}, 2.0);  // until 2 s
  test::Studio studio(builder.build(), test::camera_of(kSide, kSide, 200.0));
  const PoseEstimate pose = test::tracked(test::look_at({0.2, -0.6, 0.6}, {0, 0, 0}));
  PlanOptions all;
  all.skip = false;
  std::optional<SceneState> before;
  const ShadowNode& node = studio.scene().shadows[0];
  for (const double time : {0.0, 0.4, 0.8, 1.0, 1.5, 2.0, 2.0, 3.0}) {
    const SceneState state = evaluate_scene(studio.scene(), time);
    FramePlan plan = studio.plan(pose, all, time);
    plan.reuse = true;  // draws everything, and reuses unchanged triples
    studio.draw(test::plain_frame(kSide, kSide, 255), plan);
    std::size_t expected = 12;
    if (before) {
      const auto events = shadow_events(*before, state);
      expected = test::affected_triples(studio.scene(), node, events).size();
      EXPECT_EQ(events.size(), time <= 1.0 ? 2U : time <= 2.0 && before->time_s < 2.0 ? 1U : 0U);
      // Light 0 belongs to 6 triples (caster, plane, light). Object 0 belongs to 4, 2 of which also
      // belong to light 0 and count once.
      EXPECT_EQ(expected, time <= 1.0 ? 8U : time <= 2.0 && before->time_s < 2.0 ? 4U : 0U);
    }
    EXPECT_EQ(studio.stats()[Counter::triples_recomputed], static_cast<std::int64_t>(expected))
        << time;
    EXPECT_EQ(studio.stats()[Counter::reprojections], static_cast<std::int64_t>(12 - expected))
        << time;
    before = state;
  }
}

TEST(AnimatedLight, MovesAndRotates) {
  Scene scene;
  SceneLight& lamp = scene.lights.emplace_back();
  lamp.position = {0.1, 0.2, 0.5};
  lamp.animation = along({0.2, 0.0, 0.1}, 2.0);
  SceneLight& sky = scene.lights.emplace_back();
  sky.kind = SceneLight::Kind::directional;
  sky.direction = Eigen::Vector3d(1.0, 0.0, 1.0).normalized();
  sky.animation.spin_turns_per_s = 0.25;
  sky.intensity = 0.5;
  const SceneState state = evaluate_scene(scene, 1.0);
  EXPECT_LT((state.lights[0].position - Eigen::Vector4d(0.2, 0.2, 0.55, 1.0)).norm(), 1e-12);
  const double h = std::sqrt(0.5);
  EXPECT_LT((state.lights[1].position - Eigen::Vector4d(0.0, h, h, 0.0)).norm(), 1e-12);
  EXPECT_EQ(state.lights[1].color, Eigen::Vector3d::Constant(0.5));
}

TEST(Sun, MatchesAlmanacPositions) {
  // Example in I. Reda and A. Andreas, "Solar position algorithm for solar radiation applications"
  // (NREL/TP-560-34302): 2003-10-17 19:30:30 UTC.
  const SunPosition sun = sun_position(1066419030.0, 39.742476, -105.1786);
  EXPECT_NEAR(sun.azimuth_rad / kDegree, 194.34024, 0.02);
  EXPECT_NEAR(sun.elevation_rad / kDegree, 39.872046, 0.02);
  // At the pole, elevation equals declination: 23.44 degrees at the solstice of 2026-06-21 08:24.
  EXPECT_NEAR(sun_position(1782030240.0, 90.0, 0.0).elevation_rad / kDegree, 23.44, 0.01);
  // Equinox, 2026-03-20 14:46 UTC.
  EXPECT_NEAR(sun_position(1774017960.0, 90.0, 0.0).elevation_rad, 0.0, 0.01 * kDegree);
}

TEST(Sun, LightsTableFromItsDirection) {
  const SunPosition east{90.0 * kDegree, 30.0 * kDegree};
  const Eigen::Vector3d d = direction_to(east, 0.0);
  EXPECT_LT((d - Eigen::Vector3d(std::cos(30 * kDegree), 0.0, 0.5)).norm(), 1e-12);
  // North is rotated to -x, so that east is +y.
  EXPECT_LT((direction_to(east, 90.0) - Eigen::Vector3d(0.0, std::cos(30 * kDegree), 0.5)).norm(),
            1e-12);
  Scene scene;
  SceneLight& light = scene.lights.emplace_back();
  light.kind = SceneLight::Kind::directional;
  light.sun = Sun{48.0, 11.0, 1782000000.0, 1.0, 0.0};  // 2026-06-21 00:00 UTC; 1 s is 1 h
  EXPECT_EQ(evaluate_scene(scene, 0.0).lights[0].color.norm(), 0.0) << "night";
  const PlacedLight noon = evaluate_scene(scene, 11.3).lights[0];
  EXPECT_GT(noon.color.norm(), 0.0);
  EXPECT_NEAR(std::asin(noon.position.z()) / kDegree, 90.0 - 48.0 + 23.44, 0.05);
  EXPECT_LT(noon.position.y(), 0.0) << "in the south";
  EXPECT_GT(evaluate_scene(scene, 6.0).lights[0].position.x(), 0.0) << "in the east in the morning";
}

}  // namespace
}  // namespace penumbra::shadow_node_test
