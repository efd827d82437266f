// Light rays: the vertices that they pass through, where they end, and their depth test.
#include "render/shadow/projected/light_rays.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::light_rays_test {
namespace {

using test::RenderedImage;
using test::SceneBuilder;
using test::Studio;

constexpr int kSide = 240;
const RayReceiver kTable{PlaneFrame{}, {}};

TEST(MarkedVertices, AreBoxCornersInDistinctColours) {
  const auto marked = marked_vertices(*test::box(0.04, 0.06, 0.08), 12);
  ASSERT_EQ(marked.size(), 8U);
  for (std::size_t i = 0; i < marked.size(); ++i) {
    EXPECT_LT((marked[i].position.cwiseAbs() - Eigen::Vector3d(0.02, 0.03, 0.04)).norm(), 1e-7);
    for (std::size_t j = 0; j < i; ++j) {
      EXPECT_GT((marked[i].position - marked[j].position).norm(), 0.03);
      const glm::vec3 difference = marked[i].color - marked[j].color;
      EXPECT_GT(glm::length(difference), 0.1F) << i << " and " << j;
    }
  }
}

TEST(MarkedVertices, AreLimitedInNumberAndUseModelColours) {
  auto model = std::make_shared<Model>(*test::ring());
  EXPECT_EQ(marked_vertices(*model, 12).size(), 12U);
  for (Mesh& mesh : model->meshes) {
    mesh.colors.assign(mesh.positions.size(), glm::vec4(0.25F, 0.5F, 1.0F, 1.0F));
  }
  model->materials[0].base_color = glm::vec4(0.5F, 1.0F, 1.0F, 1.0F);
  for (const MarkedVertex& vertex : marked_vertices(*model, 5)) {
    EXPECT_EQ(vertex.color, glm::vec3(0.125F, 0.5F, 1.0F));
  }
  EXPECT_TRUE(marked_vertices(Model(), 5).empty());
}

const std::vector<MarkedVertex> kOneVertex = {{{0.1, 0.0, 0.2}, glm::vec3(1.0F)}};

TEST(LightRays, PassThroughVertexToItsShadow) {
  const auto from_point_light =
      light_rays(kOneVertex, Placement(), {0.0, 0.0, 0.6, 1.0}, {{kTable}});
  ASSERT_EQ(from_point_light.size(), 1U);
  EXPECT_EQ(from_point_light[0].from, Eigen::Vector3d(0.0, 0.0, 0.6));
  EXPECT_EQ(from_point_light[0].vertex, kOneVertex[0].position);
  EXPECT_LT((from_point_light[0].shadow - Eigen::Vector3d(0.15, 0.0, 0.0)).norm(), 1e-12);

  const auto from_parallel_light =
      light_rays(kOneVertex, test::at(0.0, 0.1, 0.0), {1.0, 0.0, 1.0, 0.0}, {{kTable}});
  ASSERT_EQ(from_parallel_light.size(), 1U);
  EXPECT_LT((from_parallel_light[0].shadow - Eigen::Vector3d(-0.1, 0.1, 0.0)).norm(), 1e-12);
  const Eigen::Vector3d to_light =
      (from_parallel_light[0].from - from_parallel_light[0].vertex).normalized();
  EXPECT_LT((to_light - Eigen::Vector3d(1.0, 0.0, 1.0).normalized()).norm(), 1e-12);
}

TEST(LightRays, EndOnNearestPlaneOfSeveral) {
  const RayReceiver wall{PlaneFrame::make({-1.0, 0.0, 0.0}, {0.12, 0.0, 0.0}), {}};
  const std::vector<RayReceiver> planes = {kTable, wall};
  const auto rays = light_rays(kOneVertex, Placement(), {0.0, 0.0, 0.6, 1.0}, planes);
  ASSERT_EQ(rays.size(), 1U);
  EXPECT_NEAR(rays[0].shadow.x(), 0.12, 1e-12);
  EXPECT_NEAR(rays[0].shadow.z(), 0.6 - 0.4 * 1.2, 1e-12);
  // A ray that misses the wall's outline continues to the table.
  const std::vector<Eigen::Vector2d> small = {{0.5, 0.5}, {0.6, 0.5}, {0.6, 0.6}};
  const std::vector<RayReceiver> with_small_wall = {kTable, {wall.frame, small}};
  const auto missing = light_rays(kOneVertex, Placement(), {0.0, 0.0, 0.6, 1.0}, with_small_wall);
  ASSERT_EQ(missing.size(), 1U);
  EXPECT_NEAR(missing[0].shadow.z(), 0.0, 1e-12);
}

TEST(LightRays, AreOmittedWhereNoShadowIsCast) {
  const auto ray_count = [&](double z, const Eigen::Vector4d& light) {
    return light_rays(kOneVertex, test::at(0.0, 0.0, z), light, {{kTable}}).size();
  };
  EXPECT_EQ(ray_count(0.0, {0.0, 0.0, 0.6, 1.0}), 1U);
  EXPECT_EQ(ray_count(0.5, {0.0, 0.0, 0.6, 1.0}), 0U) << "above the light: an antishadow";
  EXPECT_EQ(ray_count(0.4, {0.0, 0.0, 0.6, 1.0}), 0U) << "level with the light";
  EXPECT_EQ(ray_count(-0.3, {0.0, 0.0, 0.6, 1.0}), 0U) << "under the plane: a false shadow";
  EXPECT_EQ(ray_count(0.0, {0.0, 0.0, -0.6, 1.0}), 0U) << "light under the plane";
  EXPECT_EQ(ray_count(0.0, {0.0, 0.0, -1.0, 0.0}), 0U) << "light under the horizon";
  EXPECT_EQ(ray_count(0.0, {0.0, 0.0, std::nan(""), 1.0}), 0U);
}

SceneBuilder lit_box() {
  SceneBuilder builder;
  ShadowNode& node = builder.scene().shadows[0];
  node.technique = ShadowTechnique::hard;
  node.lights = {0};
  SceneLight& lamp = builder.scene().lights.emplace_back();
  lamp.name = "lamp";
  lamp.position = {0.0, 0.0, 0.4};
  builder.add(test::box(0.08, 0.08, 0.04), test::at(0.0, 0.0, 0.15));
  return builder;
}
const PoseEstimate kFromFront = test::tracked(test::look_at({0.3, -0.5, 0.45}, {0.0, 0.0, 0.1}));
Frame grey() {
  return test::plain_frame(kSide, kSide, 128);
}

// Returns the pixel of a point in the table frame.
Eigen::Vector2i pixel_of(const CameraModel& camera, const CameraPose& pose,
                         const Eigen::Vector3d& p) {
  const auto pixel = camera.project(pose.inverse() * p);
  return pixel->array().round().cast<int>();
}

// Returns the colourfulness of a pixel, which is 0 in the video and in shadows.
int color_at(const RenderedImage& image, const Eigen::Vector2i& at) {
  const std::uint8_t* p = image.at(at.x(), at.y());
  return std::max({p[0], p[1], p[2]}) - std::min({p[0], p[1], p[2]});
}

class DrawnRays : public testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(Lenses, DrawnRays, testing::Bool(), [](const auto& instance) {
  return std::string(instance.param ? "distorted" : "undistorted");
});

TEST_P(DrawnRays, HaveDotsAtVerticesAndShadowsAndLinesBetween) {
  const CameraModel camera =
      GetParam() ? test::distorted_camera(kSide, 260.0) : test::camera_of(kSide, kSide, 260.0);
  SceneBuilder builder = lit_box();
  Studio studio(builder.build(), camera);
  PlanOptions options;
  options.light_rays = true;
  FramePlan plan = studio.plan(kFromFront, options);
  plan.objects.clear();  // no object occludes the rays
  const RenderedImage image = studio.draw(grey(), plan);
  const auto rays = light_rays(marked_vertices(*builder.scene().objects[0].model, 12),
                               test::at(0.0, 0.0, 0.15), {0.0, 0.0, 0.4, 1.0}, {{kTable}});
  ASSERT_EQ(rays.size(), 8U);
  const CameraPose& pose = kFromFront.T_table_camera;
  for (const LightRay& ray : rays) {
    EXPECT_GT(color_at(image, pixel_of(camera, pose, ray.vertex)), 60);
    EXPECT_GT(color_at(image, pixel_of(camera, pose, ray.shadow)), 60);
    // Points halfway to the light and halfway to the shadow.
    for (const Eigen::Vector3d& p : {Eigen::Vector3d(0.4 * ray.from + 0.6 * ray.vertex),
                                     Eigen::Vector3d(0.5 * ray.vertex + 0.5 * ray.shadow)}) {
      const Eigen::Vector2i at = pixel_of(camera, pose, p);
      int brightest = 0;
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
          brightest = std::max(brightest, color_at(image, at + Eigen::Vector2i(dx, dy)));
        }
      }
      EXPECT_GT(brightest, 60) << "no ray at " << at.transpose();
    }
  }
}

TEST(RayOverlay, IsHiddenByObjectsInFront) {
  const CameraModel camera = test::camera_of(kSide, kSide, 260.0);
  SceneBuilder builder = lit_box();
  builder.scene().shadows[0].light_rays = true;
  // A phantom that covers the whole view in front of everything.
  builder.add(test::box(1.0, 0.002, 1.0), test::at(0.1, -0.3, 0.3), false, true);
  Studio hidden(builder.build(), camera);
  const RenderedImage image = hidden.draw(grey(), hidden.plan(kFromFront));
  Studio shown(lit_box().build(), camera);
  PlanOptions options;
  options.light_rays = true;
  FramePlan plan = shown.plan(kFromFront, options);
  plan.objects.clear();
  const RenderedImage without_phantom = shown.draw(grey(), plan);
  int colorful = 0;
  int colorful_without = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      colorful += color_at(image, {x, y}) > 30 ? 1 : 0;
      colorful_without += color_at(without_phantom, {x, y}) > 30 ? 1 : 0;
    }
  }
  EXPECT_EQ(colorful, 0);
  EXPECT_GT(colorful_without, 300);
}

TEST(RayOverlay, IsDrawnOnlyWhenEnabled) {
  const CameraModel camera = test::camera_of(kSide, kSide, 260.0);
  SceneBuilder builder = lit_box();
  Studio plain(builder.build(), camera);
  builder.scene().shadows[0].light_rays = true;
  Studio node(builder.build(), camera);
  const RenderedImage without = plain.draw(grey(), plain.plan(kFromFront));
  PlanOptions with_rays;
  with_rays.light_rays = true;
  const RenderedImage by_option = plain.draw(grey(), plain.plan(kFromFront, with_rays));
  EXPECT_NE(without, by_option);
  EXPECT_EQ(node.draw(grey(), node.plan(kFromFront)), by_option);
  EXPECT_EQ(plain.draw(grey(), plain.plan(kFromFront)), without) << "the next frame is unchanged";
  // Shadow techniques without a light have no rays.
  for (const ShadowTechnique technique :
       {ShadowTechnique::simple, ShadowTechnique::layered, ShadowTechnique::none}) {
    with_rays.technique = technique;
    EXPECT_TRUE(plain.plan(kFromFront, with_rays).rays.empty());
  }
  with_rays.technique = ShadowTechnique::volume;
  EXPECT_EQ(plain.plan(kFromFront, with_rays).rays.size(), 1U);
}

TEST(RayOverlay, FadesWithCoastingPose) {
  const CameraModel camera = test::camera_of(kSide, kSide, 260.0);
  Studio studio(lit_box().build(), camera);
  PlanOptions options;
  options.light_rays = true;
  const auto colorful = [&](double age_s) {
    PoseEstimate pose = kFromFront;
    pose.status = TrackStatus::held;
    pose.held_from = TrackStatus::tracked;
    pose.age_s = age_s;
    FramePlan plan = studio.plan(pose, options);
    plan.objects.clear();
    const RenderedImage image = studio.draw(grey(), plan);
    int brightest = 0;
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) brightest = std::max(brightest, color_at(image, {x, y}));
    }
    return brightest;
  };
  const int fresh = colorful(0.0);
  const int old = colorful(0.5 * kHoldSeconds);
  EXPECT_GT(fresh, 150);
  EXPECT_LT(old, fresh * 3 / 4);
  EXPECT_GT(old, 20);
}

// Dots of two lights at one vertex are blended once.
TEST(RayOverlay, BlendsDotsOfFadingObjectOnce) {
  const CameraModel camera = test::camera_of(kSide, kSide, 260.0);
  SceneBuilder builder = lit_box();
  SceneLight other = builder.scene().lights[0];
  other.name = "other";
  other.position = {0.02, 0.01, 0.5};
  builder.scene().lights.push_back(other);
  builder.scene().shadows[0].lights = {0, 1};
  const auto scene = builder.build();
  Studio studio(scene, camera);
  SceneState state = evaluate_scene(*scene, 0.0);
  state.opacities = {0.5};
  const auto drawn = [&](Translucency mode, std::size_t rays) {
    PlanOptions options;
    options.light_rays = true;
    options.translucency = mode;
    FramePlan plan = plan_frame(*scene, state, kFromFront, camera, options);
    EXPECT_EQ(plan.rays.size(), 2U);
    plan.rays.resize(rays);
    plan.objects.clear();
    plan.hard_shadows.clear();
    return studio.draw(grey(), plan);
  };
  const RenderedImage one_light = drawn(Translucency::blend, 1);
  const RenderedImage two_lights = drawn(Translucency::blend, 2);
  int dots = 0;
  for (const double x : {-0.04, 0.04}) {
    for (const double y : {-0.04, 0.04}) {
      const auto at = pixel_of(camera, kFromFront.T_table_camera, {x, y, 0.17});
      if (color_at(one_light, at) < 20) continue;
      ++dots;
      for (int c = 0; c < 3; ++c)
        EXPECT_EQ(two_lights.at(at.x(), at.y())[c], one_light.at(at.x(), at.y())[c]);
    }
  }
  EXPECT_GE(dots, 2);
  // Retexturing replaces video pixels and cannot blend twice, so both frames must be equal.
  const RenderedImage fetched = drawn(Translucency::retexture, 2);
  int differ = 0;
  for (std::size_t i = 0; i < two_lights.rgba.size(); ++i)
    differ += std::abs(fetched.rgba[i] - two_lights.rgba[i]) > 1 ? 1 : 0;
  EXPECT_LE(differ, 60) << "at equal depth the first or the last colour wins";
}

// Skipping rays out of view must not change the frame.
TEST(RayOverlay, SkipsRaysOutOfView) {
  std::mt19937 random(3);
  const auto uniform = [&random](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  std::size_t skipped = 0;
  std::size_t drawn = 0;
  for (int i = 0; i < 30; ++i) {
    SceneBuilder builder = lit_box();
    SceneLight& lamp = builder.scene().lights[0];
    if (i % 2 == 0) {
      lamp.position = {uniform(-0.8, 0.8), uniform(-0.8, 0.8), uniform(0.1, 0.6)};
    } else {
      lamp.kind = SceneLight::Kind::directional;
      lamp.direction = {uniform(-1, 1), uniform(-1, 1), uniform(0.2, 1)};
    }
    for (SceneObject& object : builder.scene().objects) {
      object.placement = test::at(uniform(-0.9, 0.9), uniform(-0.9, 0.9), uniform(0.0, 0.3));
    }
    builder.add(test::box(0.05, 0.05, 0.05),
                test::at(uniform(-0.9, 0.9), uniform(-0.9, 0.9), uniform(0.0, 0.3)));
    Studio studio(builder.build(), i % 3 == 0 ? test::distorted_camera(kSide, 260.0)
                                              : test::camera_of(kSide, kSide, 260.0));
    const PoseEstimate pose =
        test::tracked(test::look_at({uniform(-0.5, 0.5), -0.4, uniform(0.1, 0.6)},
                                    {uniform(-0.3, 0.3), uniform(-0.3, 0.3), 0.0}));
    PlanOptions options;
    options.light_rays = true;
    const FramePlan skipping = studio.plan(pose, options);
    options.skip = false;
    const FramePlan complete = studio.plan(pose, options);
    EXPECT_EQ(complete.rays.size(), 2U);
    const auto reported =
        std::ranges::count(skipping.skipped, SkipReason::rays_out_of_view, &SkippedPass::reason);
    EXPECT_EQ(skipping.rays.size() + static_cast<std::size_t>(reported), 2U);
    skipped += static_cast<std::size_t>(reported);
    drawn += skipping.rays.size();
    EXPECT_EQ(studio.draw(grey(), skipping), studio.draw(grey(), complete)) << i;
  }
  EXPECT_GT(skipped, 5U);
  EXPECT_GT(drawn, 10U);
}

}  // namespace
}  // namespace penumbra::light_rays_test
