// Layered, field and simple shadows on phantoms: each height of a phantom against the shadow on a
// plane there, and what may be kept or left out.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "render/shadow/caster.hpp"
#include "render/shadow/kernel_direction.hpp"
#include "render/shadow/receiving_levels.hpp"
#include "render/shapes.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::phantom_shadow_test {
namespace {

using test::box;
using test::Picture;
using test::SceneBuilder;
using test::ShapeBuilder;
using test::Studio;

constexpr int kSide = 300;

Frame white() {
  return test::plain_frame(kSide, kSide, 255);
}
CameraModel camera() {
  return test::camera_of(kSide, kSide, 420.0);
}
PoseEstimate from(const Eigen::Vector3d& eye) {
  return test::tracked(test::look_at(eye, {0.0, 0.0, 0.05}));
}
std::shared_ptr<const Model> solid(const Model& shape) {
  return test::finished(shape, glm::vec4(1.0F));
}
// Two arms of unequal length.
std::shared_ptr<const Model> l_shape() {
  ShapeBuilder shape;
  shape.box(-0.04, -0.04, 0.0, 0.05, -0.015, 0.02);
  shape.box(-0.04, -0.015, 0.0, -0.015, 0.04, 0.02);
  return solid(shape.build());
}
SceneBuilder builder_with(ShadowTechnique technique,
                          LightMode light_mode = LightMode::proportional) {
  SceneBuilder builder;
  ShadowNode& node = builder.scene().shadows[0];
  node.technique = technique;
  node.light_mode = light_mode;
  node.layered = make_layered_constants(0.6, 2.5, 0.0).value();
  node.fractions = {0.1, 0.3, 0.7};
  return builder;
}

std::vector<double> levels_of(const Model& model, const Placement& placement) {
  return receiving_levels(model, placement, PlaneFrame(), 16);
}

TEST(ReceivingLevels, AreWhereTheSurfaceFacesTheLight) {
  const Model cube = make_box(glm::vec3(0.1F));
  const auto top = levels_of(cube, test::at(0.2, 0.1, 0.05, {0, 0, 1}, 0.7));
  ASSERT_EQ(top.size(), 1U);
  EXPECT_NEAR(top[0], 0.1, 1e-8);
  EXPECT_TRUE(levels_of(cube, test::at(0, 0, -0.06)).empty()) << "under the plane";
  EXPECT_EQ(levels_of(make_cylinder(0.03F, 0.08F), test::at(0, 0, 0.04)).size(), 1U);
  // Two steps.
  ShapeBuilder steps;
  steps.box(0, 0, 0, 0.05, 0.1, 0.02);
  steps.box(0.05, 0, 0, 0.1, 0.1, 0.06);
  const auto two = levels_of(steps.build(), Placement());
  ASSERT_EQ(two.size(), 2U);
  EXPECT_NEAR(two[0], 0.02, 1e-8);
  EXPECT_NEAR(two[1], 0.06, 1e-8);
}

TEST(ReceivingLevels, OfSlopesLieCloseTogether) {
  // The upper half of a sphere, and a roof that stands on the table.
  const auto ball = levels_of(make_sphere(0.03F), test::at(0, 0, 0.03));
  EXPECT_GT(ball.size(), 5U);
  EXPECT_LE(ball.size(), 16U);
  EXPECT_NEAR(ball.front(), 0.03, 0.003);
  EXPECT_NEAR(ball.back(), 0.06, 1e-8);
  const auto tilted = levels_of(make_box(glm::vec3(0.4F)), test::at(0, 0, 0, {1, 0, 0}, 0.7));
  EXPECT_LE(tilted.size(), 16U);
  EXPECT_EQ(tilted.front(), 0.0) << "what is under the plane receives nothing";
  for (const auto& levels : {ball, tilted}) {
    EXPECT_TRUE(std::ranges::is_sorted(levels));
    for (std::size_t i = 1; i < levels.size(); ++i) {
      EXPECT_LT(levels[i] - levels[i - 1], 1.6 * levels.back() / 14.0);
    }
  }
}

TEST(ReceivingLevels, OfAnyTriangles) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> place(-0.2, 0.2);
  for (int i = 0; i < 200; ++i) {
    ShapeBuilder soup;
    for (int face = 0; face < 12; ++face) {
      const auto corner = [&] { return soup.vertex(place(random), place(random), place(random)); };
      const std::uint32_t a = corner();
      const std::uint32_t b = corner();
      soup.triangle(a, b, i % 7 == 0 ? b : corner());
    }
    const std::size_t most = 2 + static_cast<std::size_t>(i) % 15;
    const auto levels = receiving_levels(soup.build(), test::at(0, 0, 0.05, {1, 2, 3}, 0.1 * i),
                                         PlaneFrame(), most);
    EXPECT_LE(levels.size(), most);
    EXPECT_TRUE(std::ranges::is_sorted(levels));
    for (const double level : levels) EXPECT_TRUE(level >= 0.0 && level < 1.0);
  }
}

struct Technique {
  const char* name;
  ShadowTechnique technique;
  LightMode light_mode = LightMode::proportional;
};
class PhantomShadow : public testing::TestWithParam<Technique> {};
INSTANTIATE_TEST_SUITE_P(Techniques, PhantomShadow,
                         testing::Values(Technique{"simple", ShadowTechnique::simple},
                                         Technique{"layered", ShadowTechnique::layered},
                                         Technique{"fixed_light", ShadowTechnique::layered,
                                                   LightMode::fixed},
                                         Technique{"field", ShadowTechnique::field}),
                         [](const auto& instance) { return std::string(instance.param.name); });

// The top of a real box is a plane like any other.
TEST_P(PhantomShadow, OnALevelTopIsThatOfAPlaneThere) {
  constexpr double kTop = 0.07;
  const Placement placement = test::at(0.015, 0.01, 0.2, {0.3, 1.0, 0.2}, 0.4);
  const auto scene = [&](bool phantom) {
    SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
    builder.add(l_shape(), placement);
    if (phantom) {
      builder.add(box(0.12, 0.1, kTop), test::at(0.02, 0.0, kTop / 2), false, true);
    } else {
      builder.scene().planes[0].point = {0.0, 0.0, kTop};
    }
    return builder.build();
  };
  Studio with_phantom(scene(true), camera());
  Studio with_plane(scene(false), camera());
  const Eigen::Vector3d eye(0.1, -0.35, 0.6);
  const PoseEstimate pose = from(eye);
  const Picture on_phantom = with_phantom.draw_shadows(white(), with_phantom.plan(pose));
  const Picture on_plane = with_plane.draw_shadows(white(), with_plane.plan(pose));
  int dark = 0;
  int wrong = 0;
  int dark_sides = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = camera().unproject({static_cast<double>(x), static_cast<double>(y)});
      ASSERT_TRUE(ray);
      const Eigen::Vector3d d = pose.T_table_camera.rotation() * *ray;
      const Eigen::Vector3d p = eye + (kTop - eye.z()) / d.z() * d;
      if (std::abs(p.x() - 0.02) < 0.0595 && std::abs(p.y()) < 0.0495) {
        dark += on_plane.red(x, y) < 250 ? 1 : 0;
        wrong += std::abs(on_phantom.red(x, y) - on_plane.red(x, y)) > 2 ? 1 : 0;
        continue;
      }
      // Its front, which gets nothing of a light from straight above.
      const Eigen::Vector3d q = eye + (-0.05 - eye.y()) / d.y() * d;
      const bool front = std::abs(q.x() - 0.02) < 0.0595 && q.z() > 0.0005 && q.z() < kTop - 0.0005;
      dark_sides += front && on_phantom.red(x, y) != 255 ? 1 : 0;
    }
  }
  EXPECT_GT(dark, 1000);
  // Smooth edges on one side, jagged ones on the other.
  EXPECT_LT(wrong, 0.06 * dark);
  EXPECT_EQ(dark_sides, 0);
}

// Every pixel of a real ball against the shadow on a plane at its own height.
TEST(PhantomShadow, OnABallIsThatOfItsHeights) {
  SceneBuilder builder = builder_with(ShadowTechnique::layered);
  const auto caster = l_shape();
  const Placement placement = test::at(0.0, 0.0, 0.17, {0, 0, 1}, 0.4);
  builder.add(caster, placement);
  constexpr double kRadius = 0.05;
  const Eigen::Vector3d middle(0.03, 0.02, kRadius);
  builder.add(solid(make_sphere(static_cast<float>(kRadius))),
              {middle, Eigen::Quaterniond::Identity(), 1.0}, false, true);
  Studio studio(builder.build(), camera());
  const Eigen::Vector3d eye(0.15, -0.4, 0.5);
  const PoseEstimate pose = from(eye);
  const Picture picture = studio.draw_shadows(white(), studio.plan(pose));

  const ShadowNode& node = studio.scene().shadows[0];
  const ShadowMesh mesh = make_shadow_mesh(*caster);
  const ShadowKernels kernels = generate_kernels(
      mesh, KernelDirection::nearest(Eigen::Vector3d::UnitZ()).up(), KernelSource::automatic);
  const auto left_at = [&](const Eigen::Vector3d& p) {
    const PlaneFrame plane = PlaneFrame::make({0, 0, 1}, {0, 0, p.z()});
    const auto vertices = place_caster(mesh, kernels, placement, plane);
    const double fractions[] = {node.fractions.umbra, node.fractions.middle,
                                node.fractions.penumbra};
    for (std::size_t i = 0; i < 3; ++i) {
      const auto triangles =
          layer_triangles(vertices, mesh.indices, node.layered, kShadowLayers[i]);
      for (std::size_t t = 0; t + 2 < triangles.size(); t += 3) {
        const auto side = [&](const PlanePoint& a, const PlanePoint& b) {
          return (static_cast<double>(b.u) - static_cast<double>(a.u)) *
                     (p.y() - static_cast<double>(a.v)) -
                 (static_cast<double>(b.v) - static_cast<double>(a.v)) *
                     (p.x() - static_cast<double>(a.u));
        };
        const double s0 = side(triangles[t], triangles[t + 1]);
        const double s1 = side(triangles[t + 1], triangles[t + 2]);
        const double s2 = side(triangles[t + 2], triangles[t]);
        if ((s0 >= 0 && s1 >= 0 && s2 >= 0) || (s0 <= 0 && s1 <= 0 && s2 <= 0)) return fractions[i];
      }
    }
    return 1.0;
  };
  int on_ball = 0;
  int dark = 0;
  int wrong = 0;
  for (int y = 0; y < kSide; y += 2) {
    for (int x = 0; x < kSide; x += 2) {
      const auto ray = camera().unproject({static_cast<double>(x), static_cast<double>(y)});
      const Eigen::Vector3d d = (pose.T_table_camera.rotation() * *ray).normalized();
      const double b = d.dot(eye - middle);
      const double under = b * b - (eye - middle).squaredNorm() + kRadius * kRadius;
      if (under < 4e-5) continue;  // its rim is that of a polyhedron
      const Eigen::Vector3d p = eye + (-b - std::sqrt(under)) * d;
      const double facing = std::max((p - middle).z() / kRadius, 0.0);
      const double lost = (1.0 - left_at(p)) * facing;
      const double expected = 255.0 * std::pow(1.0 - lost, 1.0 / 2.2);
      ++on_ball;
      dark += expected < 240.0 ? 1 : 0;
      // Faces turn by 4 degrees from one to the next.
      wrong += std::abs(picture.red(x, y) - expected) > 14.0 ? 1 : 0;
    }
  }
  EXPECT_GT(on_ball, 800);
  EXPECT_GT(dark, 250);
  EXPECT_LT(wrong, 0.06 * dark) << "more than edges, of " << dark;
}

// What stands beside a real thing and no higher throws nothing on its top.
TEST_P(PhantomShadow, FallsDownwards) {
  SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
  builder.add(box(0.04, 0.04, 0.06), test::at(0.0, 0.0, 0.03));
  builder.add(box(0.04, 0.04, 0.08), test::at(0.0, 0.0, 0.04), false, true);
  Studio studio(builder.build(), camera());
  FramePlan plan = studio.plan(from({0.1, -0.3, 0.5}));
  const Picture with = studio.draw_shadows(white(), plan);
  plan.phantom_shadows.clear();
  EXPECT_EQ(with, studio.draw_shadows(white(), plan));
}

// What is left out or kept changes nothing.
TEST_P(PhantomShadow, IsTheSameWhatsoeverIsSkipped) {
  std::mt19937 random(5);
  const auto within = [&random](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  int left_out = 0;
  int drawn = 0;
  for (int i = 0; i < 16; ++i) {
    SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
    builder.add(l_shape(), test::at(within(-0.12, 0.12), within(-0.12, 0.12), within(0.0, 0.3),
                                    {1, 1, 0}, within(0, 3)));
    builder.add(box(within(0.02, 0.1), within(0.02, 0.1), within(0.02, 0.1)),
                test::at(within(-0.12, 0.12), within(-0.12, 0.12), within(-0.05, 0.1), {0, 1, 1},
                         i % 2 == 0 ? 0.0 : within(0, 3)),
                false, true);
    Studio studio(builder.build(), camera());
    const PoseEstimate pose = from({0.3, -0.4, 0.5});
    PlanOptions all;
    all.skip = false;
    const FramePlan skipping = studio.plan(pose);
    const FramePlan whole = studio.plan(pose, all);
    EXPECT_EQ(whole.phantom_shadows.size(), 1U);
    (skipping.phantom_shadows.empty() ? left_out : drawn) += 1;
    EXPECT_EQ(studio.draw(white(), skipping), studio.draw(white(), whole)) << i;
  }
  EXPECT_GT(left_out, 1);
  EXPECT_GT(drawn, 3);
}

TEST_P(PhantomShadow, IsKeptWhileOnlyTheCameraMoves) {
  SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
  builder.add(l_shape(), test::at(0.0, 0.0, 0.15));
  builder.add(box(0.08, 0.08, 0.04), test::at(0.02, 0.0, 0.02), false, true);
  const auto scene = builder.build();
  Studio studio(scene, camera());
  studio.draw(white(), studio.plan(from({0.1, -0.3, 0.5})));
  EXPECT_EQ(studio.stats().masks_drawn, 1);
  EXPECT_EQ(studio.stats().masks_kept, 0);
  EXPECT_EQ(studio.stats().triples_recomputed, 1) << "a phantom's top is no plane of the scene";
  const FramePlan moved = studio.plan(from({-0.2, -0.3, 0.4}));
  const Picture kept = studio.draw(white(), moved);
  EXPECT_EQ(studio.stats().masks_drawn, 0);
  EXPECT_EQ(studio.stats().masks_kept, 1);
  EXPECT_EQ(studio.stats().shadow_vertices, 0);
  Studio fresh(scene, camera());
  EXPECT_EQ(kept, fresh.draw(white(), fresh.plan(from({-0.2, -0.3, 0.4}))));
  // The caster slides: drawn anew, from what there is.
  FramePlan slid = moved;
  for (ShadowDraw& draw : slid.shadows) draw.T_table_object.position.x() += 0.01;
  for (PhantomShadowDraw& draw : slid.phantom_shadows)
    draw.shadow.T_table_object.position.x() += 0.01;
  EXPECT_NE(studio.draw(white(), slid), kept);
  EXPECT_EQ(studio.stats().masks_drawn, 1);
  EXPECT_EQ(studio.stats().shadow_vertices, 0);
  EXPECT_EQ(studio.stats().kernel_generations, 0);
}

// Several casters, and planes in one place: the darkest, once.
TEST(PhantomShadow, DarkensOnce) {
  const auto picture = [](int casters, int planes) {
    SceneBuilder builder = builder_with(ShadowTechnique::simple);
    for (int i = 0; i < casters; ++i) {
      builder.add(box(0.05, 0.05, 0.01), test::at(0.0, 0.0, 0.1 + 0.05 * i));
    }
    builder.add(box(0.1, 0.1, 0.04), test::at(0.0, 0.0, 0.02), false, true);
    for (int i = 1; i < planes; ++i) {
      builder.scene().planes.push_back(builder.scene().planes[0]);
      builder.scene().shadows[0].planes.push_back(i);
    }
    Studio studio(builder.build(), camera());
    return studio.draw_shadows(white(), studio.plan(from({0.1, -0.3, 0.5})));
  };
  const Picture once = picture(1, 1);
  EXPECT_EQ(picture(2, 1), once);
  EXPECT_EQ(picture(1, 2), once);
  EXPECT_EQ(picture(3, 3), once);
}

// A board's shadow falls along the board's normal.
TEST(PhantomShadow, FallsTowardsItsPlane) {
  SceneBuilder builder = builder_with(ShadowTechnique::simple);
  builder.scene().planes[0].normal = {0.0, -1.0, 0.0};
  builder.scene().planes[0].point = {0.0, 0.3, 0.0};
  builder.add(box(0.05, 0.01, 0.05), test::at(0.0, -0.1, 0.05));
  builder.add(box(0.1, 0.1, 0.1), test::at(0.0, 0.05, 0.05), false, true);
  Studio studio(builder.build(), camera());
  const Eigen::Vector3d eye(0.1, -0.6, 0.35);
  const PoseEstimate pose = from(eye);
  const Picture picture = studio.draw_shadows(white(), studio.plan(pose));
  const auto red_at = [&](const Eigen::Vector3d& place) {
    const auto pixel = camera().project(pose.T_table_camera.inverse() * place);
    return picture.red(static_cast<int>(std::lround(pixel->x())),
                       static_cast<int>(std::lround(pixel->y())));
  };
  EXPECT_LT(red_at({0.0, 0.0, 0.05}), 200) << "its front";
  EXPECT_EQ(red_at({0.04, 0.0, 0.05}), 255);
  EXPECT_EQ(red_at({0.0, 0.05, 0.1}), 255) << "its top";
}

}  // namespace
}  // namespace penumbra::phantom_shadow_test
