#include "render/frame_plan.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::SceneBuilder;

std::shared_ptr<const Model> cube(double side) {
  test::ShapeBuilder shape;
  shape.box(-side / 2, -side / 2, -side / 2, side / 2, side / 2, side / 2);
  return test::finished(shape.build(), glm::vec4(1.0F));
}

CameraModel camera() {
  return test::camera_of(320, 240, 300.0);
}
PoseEstimate above() {
  return test::tracked(test::look_at({0.0, -0.4, 0.5}, {0.0, 0.0, 0.0}));
}

std::vector<std::string> skip_names(const FramePlan& plan) {
  std::vector<std::string> names;
  for (const SkippedPass& skipped : plan.skipped) names.emplace_back(key_of(skipped.reason));
  return names;
}
FramePlan plan_of(const SceneBuilder& builder, const PoseEstimate& pose,
                  const PlanOptions& options = {}) {
  const auto scene = builder.build();
  SceneState state;
  for (const SceneObject& object : scene->objects) state.objects.push_back(object.placement);
  return plan_frame(*scene, state, pose, camera(), options);
}

TEST(FramePlan, DrawsEverythingInView) {
  SceneBuilder builder;
  builder.add(cube(0.05), test::at(0, 0, 0.1));
  builder.add(cube(0.05), test::at(0.1, 0, 0.025), true, true);
  const FramePlan plan = plan_of(builder, above());
  EXPECT_TRUE(plan.has_pose);
  EXPECT_EQ(plan.overlay_opacity, 1.0F);
  EXPECT_EQ(plan.objects.size(), 1U);
  EXPECT_EQ(plan.phantoms.size(), 1U);
  ASSERT_EQ(plan.shadows.size(), 2U);
  EXPECT_TRUE(plan.shadows[0].umbra && plan.shadows[0].middle && plan.shadows[0].penumbra);
  EXPECT_EQ(plan.received_shadows.size(), 1U);
  // The phantom is too low to cast a shadow on the cube.
  EXPECT_EQ(skip_names(plan), std::vector<std::string>{"shadow_misses_objects"});
}

TEST(FramePlan, DrawsNothingWithoutPose) {
  SceneBuilder builder;
  builder.add(cube(0.05), test::at(0, 0, 0.1));
  PoseEstimate lost;
  lost.reason = {PoseCause::no_tag};
  const FramePlan plan = plan_of(builder, lost);
  EXPECT_FALSE(plan.has_pose);
  EXPECT_TRUE(plan.objects.empty() && plan.shadows.empty());
  EXPECT_THAT(skip_names(plan), testing::ElementsAre("no_pose"));
  // The mode decides how the video is converted, so the background does not change with the pose.
  PlanOptions retextured;
  retextured.translucency = Translucency::retexture;
  EXPECT_EQ(plan_of(builder, lost, retextured).translucency, Translucency::retexture);
  EXPECT_EQ(text_of(plan.skipped[0], builder.scene()), "overlay: no pose");

  PoseEstimate broken = above();
  broken.T_table_camera =
      CameraPose(Eigen::Quaterniond::Identity(),
                 Eigen::Vector3d(std::numeric_limits<double>::quiet_NaN(), 0.0, 0.0));
  EXPECT_FALSE(plan_of(builder, broken).has_pose);
}

TEST(FramePlan, SkipsObjectsOutOfView) {
  SceneBuilder builder;
  builder.add(cube(0.05), test::at(3.0, 0, 0.1));
  const FramePlan plan = plan_of(builder, above());
  EXPECT_TRUE(plan.objects.empty() && plan.shadows.empty());
  EXPECT_THAT(skip_names(plan), testing::ElementsAre("object_out_of_view", "shadow_out_of_view"));
  EXPECT_EQ(text_of(plan.skipped[0], builder.scene()), "object1: outside the view");
  PlanOptions all;
  all.skip = false;
  const FramePlan whole = plan_of(builder, above(), all);
  EXPECT_EQ(whole.objects.size(), 1U);
  EXPECT_EQ(whole.shadows.size(), 1U);
}

TEST(FramePlan, KeepsShadowOfObjectOutOfView) {
  SceneBuilder builder;
  builder.add(cube(0.05), test::at(0, 0.1, 0.28));
  const FramePlan plan =
      plan_of(builder, test::tracked(test::look_at({0.0, -0.2, 0.25}, {0.0, 0.1, -0.05})));
  EXPECT_TRUE(plan.objects.empty());
  EXPECT_EQ(plan.shadows.size(), 1U);
}

TEST(FramePlan, DropsLayersAboveTheirHeights) {
  SceneBuilder builder;
  builder.scene().shadows[0].layered = make_layered_constants(0.4, 4.0, 0.0).value();  // h_u 0.1
  builder.add(cube(0.02), test::at(0, 0, 0.12));
  const FramePlan plan = plan_of(builder, above());
  ASSERT_EQ(plan.shadows.size(), 1U);
  EXPECT_FALSE(plan.shadows[0].umbra);
  EXPECT_TRUE(plan.shadows[0].middle && plan.shadows[0].penumbra);
  EXPECT_THAT(skip_names(plan), testing::ElementsAre("umbra_vanished"));

  SceneBuilder high;
  high.scene().shadows[0].layered = builder.scene().shadows[0].layered;
  high.add(cube(0.02), test::at(0, 0, 0.45));
  EXPECT_THAT(skip_names(plan_of(high, above())), testing::Contains("shadow_above_light"));

  // In a field, each part has its own umbra height. It is known only when the field is computed, so
  // the plan keeps all layers.
  PlanOptions field;
  field.technique = ShadowTechnique::field;
  const FramePlan fields = plan_of(builder, above(), field);
  ASSERT_EQ(fields.shadows.size(), 1U);
  EXPECT_TRUE(fields.shadows[0].umbra && fields.shadows[0].middle && fields.shadows[0].penumbra);
  EXPECT_THAT(skip_names(fields), testing::IsEmpty());
  EXPECT_THAT(skip_names(plan_of(high, above(), field)), testing::Contains("shadow_above_light"));

  SceneBuilder low;
  low.add(cube(0.02), test::at(0, 0, -0.05));
  EXPECT_THAT(skip_names(plan_of(low, above())), testing::Contains("shadow_below_plane"));
}

TEST(FramePlan, ReportsOtherSkipReasons) {
  SceneBuilder builder;
  const int quiet = builder.add(cube(0.02), test::at(0, 0, 0.1));
  builder.scene().objects[static_cast<std::size_t>(quiet)].casts_shadow = false;
  EXPECT_THAT(skip_names(plan_of(builder, above())), testing::ElementsAre("casts_no_shadow"));
  PlanOptions none;
  none.technique = ShadowTechnique::none;
  EXPECT_THAT(skip_names(plan_of(builder, above(), none)), testing::ElementsAre("technique_none"));
  EXPECT_THAT(
      skip_names(plan_of(builder, test::tracked(test::look_at({0, -0.4, -0.5}, {0, 0, 0})))),
      testing::ElementsAre("camera_behind_plane"));

  SceneBuilder beside;
  beside.add(cube(0.02), test::at(0, 0, 0.05));
  beside.scene().planes[0].outline = {{1.0, 1.0}, {1.2, 1.0}, {1.2, 1.2}};
  EXPECT_THAT(skip_names(plan_of(beside, above())), testing::ElementsAre("shadow_off_receiver"));
}

TEST(FramePlan, OverridesNodesByOptions) {
  SceneBuilder builder;
  builder.add(cube(0.02), test::at(0, 0, 0.1));
  PlanOptions options;
  options.technique = ShadowTechnique::simple;
  options.kernels = KernelSource::centroid;
  const FramePlan plan = plan_of(builder, above(), options);
  ASSERT_EQ(plan.shadows.size(), 1U);
  EXPECT_EQ(plan.shadows[0].technique, ShadowTechnique::simple);
  EXPECT_EQ(plan.shadows[0].kernels, KernelSource::centroid);
  EXPECT_FALSE(plan.shadows[0].umbra || plan.shadows[0].penumbra);
}

TEST(FramePlan, FadesOverlayOfUncertainPose) {
  SceneBuilder builder;
  builder.add(cube(0.05), test::at(0, 0, 0.1));
  PoseEstimate pose = above();
  pose.status = TrackStatus::uncertain;
  const FramePlan plan = plan_of(builder, pose);
  EXPECT_EQ(plan.overlay_opacity, 0.5F);
  EXPECT_EQ(plan.objects.size(), 1U);

  // A pose that coasts from an uncertain pose must not draw the overlay brighter.
  pose.status = TrackStatus::held;
  pose.held_from = TrackStatus::uncertain;
  pose.age_s = 0.0;
  EXPECT_EQ(plan_of(builder, pose).overlay_opacity, 0.5F);
  pose.age_s = 0.5 * kHoldSeconds;
  EXPECT_EQ(plan_of(builder, pose).overlay_opacity, 0.25F);
  pose.age_s = kHoldSeconds;
  EXPECT_FALSE(plan_of(builder, pose).has_pose);
}

TEST(FramePlan, FadesOverlayOfCoastingPoseOverTime) {
  SceneBuilder builder;
  PoseEstimate pose = above();
  pose.status = TrackStatus::held;
  float last = 1.01F;
  for (const double age : {0.0, 0.1, 0.2, 0.4}) {
    pose.age_s = age;
    const float opacity = plan_of(builder, pose).overlay_opacity;
    EXPECT_LT(opacity, last);
    EXPECT_GT(opacity, 0.0F);
    last = opacity;
  }
  pose.age_s = 0.5;
  EXPECT_THAT(skip_names(plan_of(builder, pose)), testing::ElementsAre("faded_out"));
}

// A light above the table; negative z puts it below.
SceneLight light_at_height(double z) {
  SceneLight light;
  light.name = fmt::format("light at {}", z);
  light.position = Eigen::Vector3d(0.1, 0.0, z);
  return light;
}

SceneBuilder lit_by(const std::vector<double>& heights) {
  SceneBuilder builder;
  builder.add(cube(0.05), test::at(0, 0, 0.1));
  ShadowNode& node = builder.scene().shadows[0];
  node.technique = ShadowTechnique::hard;
  for (const double z : heights) {
    node.lights.push_back(static_cast<int>(builder.scene().lights.size()));
    builder.scene().lights.push_back(light_at_height(z));
  }
  return builder;
}

FramePlan evaluated_plan_of(const SceneBuilder& builder) {
  const auto scene = builder.build();
  return plan_frame(*scene, evaluate_scene(*scene, 0.0), above(), camera(), {});
}

TEST(FramePlan, SkipsLightsInOrUnderPlane) {
  SceneBuilder lit = lit_by({1.0, 0.0, -1.0});
  const FramePlan plan = evaluated_plan_of(lit);
  EXPECT_EQ(plan.hard_shadows.size(), 1U);
  ASSERT_THAT(skip_names(plan), testing::ElementsAre("light_below_plane", "light_below_plane"));
  EXPECT_THAT(text_of(plan.skipped[0], lit.scene()), testing::HasSubstr("light at 0"));
  EXPECT_THAT(text_of(plan.skipped[1], lit.scene()), testing::HasSubstr("light at -1"));
  // A sun below the horizon does not light the plane either.
  SceneBuilder night = lit_by({1.0});
  night.scene().lights[0].kind = SceneLight::Kind::directional;
  night.scene().lights[0].direction = Eigen::Vector3d(0.6, 0.0, -0.8);
  EXPECT_THAT(skip_names(evaluated_plan_of(night)), testing::ElementsAre("light_below_plane"));
}

TEST(FramePlan, SkipsLastLightsBeyondPlaneLimit) {
  std::vector<double> heights;
  for (std::size_t i = 0; i < kMaxHardLights; ++i)
    heights.push_back(1.0 + 0.01 * static_cast<double>(i));
  const FramePlan full = evaluated_plan_of(lit_by(heights));
  EXPECT_TRUE(skip_names(full).empty());
  heights.insert(heights.end(), {2.5, 3.5});
  SceneBuilder lit = lit_by(heights);
  const FramePlan plan = evaluated_plan_of(lit);
  EXPECT_EQ(plan.hard_shadows.size(), full.hard_shadows.size());
  ASSERT_THAT(skip_names(plan), testing::ElementsAre("too_many_lights", "too_many_lights"));
  EXPECT_THAT(text_of(plan.skipped[0], lit.scene()), testing::HasSubstr("light at 2.5"));
  EXPECT_THAT(text_of(plan.skipped[1], lit.scene()), testing::HasSubstr("light at 3.5"));
}

TEST(RenderWork, HasTextForEveryReason) {
  const Scene scene;
  for (int i = 0; i < static_cast<int>(SkipReason::count); ++i) {
    EXPECT_FALSE(key_of(static_cast<SkipReason>(i)).empty()) << i;
    EXPECT_FALSE(text_of(SkippedPass{static_cast<SkipReason>(i), 0, 0}, scene).empty()) << i;
  }
  for (int i = 0; i < static_cast<int>(KeepReason::count); ++i) {
    EXPECT_FALSE(key_of(static_cast<KeepReason>(i)).empty()) << i;
    EXPECT_FALSE(text_of(KeptResult{static_cast<KeepReason>(i), 0, 0}, scene).empty()) << i;
  }
  EXPECT_EQ(key_of(SkipReason::volume_too_far), "volume_too_far");
  EXPECT_EQ(key_of(KeepReason::phantom_mask), "phantom_mask");
}

TEST(RenderCounters, AddByIndexAndHaveReportNames) {
  RenderCounters a;
  RenderCounters b;
  a[Counter::shadow_vertices] = 3;
  b[Counter::shadow_vertices] = 4;
  b[Counter::draw_calls] = 5;
  a += b;
  EXPECT_EQ(a[Counter::shadow_vertices], 7);
  EXPECT_EQ(a[Counter::draw_calls], 5);
  const auto name_of = [](Counter counter) {
    return kCounterNames[static_cast<std::size_t>(counter)];
  };
  EXPECT_EQ(name_of(Counter::masks_kept), "phantom_masks_kept");
  EXPECT_EQ(name_of(Counter::faces_tested), "kernel_faces");
  EXPECT_EQ(name_of(Counter::passes_skipped), "passes_skipped");
}

}  // namespace
}  // namespace penumbra
