// Contact shades (docs/shadows.md#contact-shade).
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <random>
#include <string>
#include <vector>

#include "render/model/to_eigen.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/fields/contact_shade.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::contact_shade_test {
namespace {

using test::at;
using test::box;
using test::RenderedImage;
using test::SceneBuilder;
using test::Studio;

constexpr int kSide = 320;
constexpr std::uint8_t kGrey = 180;

const Eigen::Vector3d kHalf(0.02, 0.015, 0.01);  // half sides of the box [m]

// Points on the surface of the box, 0.4 mm apart, on the plane at height 0.
std::vector<Eigen::Vector3d> surface_points(const Placement& placement) {
  std::vector<Eigen::Vector3d> points;
  constexpr double kStep = 0.0004;
  for (int axis = 0; axis < 3; ++axis) {
    const int u = (axis + 1) % 3;
    const int v = (axis + 2) % 3;
    const int columns = static_cast<int>(2.0 * kHalf[u] / kStep);
    const int rows = static_cast<int>(2.0 * kHalf[v] / kStep);
    for (int i = 0; i <= columns; ++i) {
      for (int j = 0; j <= rows; ++j) {
        Eigen::Vector3d p;
        p[u] = -kHalf[u] + 2.0 * kHalf[u] * i / columns;
        p[v] = -kHalf[v] + 2.0 * kHalf[v] * j / rows;
        for (const double side : {-1.0, 1.0}) {
          p[axis] = side * kHalf[axis];
          points.push_back(placement * p);
        }
      }
    }
  }
  return points;
}

TEST(ContactShade, IsGreatestOverDiscsOfPoints) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  const auto model = box(2.0 * kHalf.x(), 2.0 * kHalf.y(), 2.0 * kHalf.z());
  const ShadowMesh mesh = make_shadow_mesh(*model);
  const ShadowKernels none{Eigen::Vector3d::UnitZ(), mesh.positions, {}};
  for (int trial = 0; trial < 12; ++trial) {
    const double reach = 0.003 + 0.002 * std::abs(unit(random));
    Placement placement = at(0.0, 0.0, 0.0, {unit(random), unit(random), unit(random)},
                             trial < 4 ? 0.0 : unit(random));
    double bottom = 1.0;
    for (const glm::vec3& p : mesh.positions)
      bottom = std::min(bottom, (placement * to_eigen(p)).z());
    placement.position.z() = -bottom + 0.5 * reach * std::abs(unit(random));
    const ShadowField field =
        contact_shade(place_caster(mesh, none, placement, PlaneFrame()), mesh.indices, reach);
    ASSERT_GT(field.cell, 0.0);
    std::vector<Eigen::Vector3d> low = surface_points(placement);
    std::erase_if(low, [&](const Eigen::Vector3d& p) { return p.z() >= reach; });
    double greatest_error = 0.0;
    for (int sample = 0; sample < 400; ++sample) {
      const int column = static_cast<int>((0.5 + 0.5 * unit(random)) * (field.width - 1));
      const int row = static_cast<int>((0.5 + 0.5 * unit(random)) * (field.height - 1));
      const Eigen::Vector2d cell =
          field.origin + field.cell * Eigen::Vector2d(column + 0.5, row + 0.5);
      double expected = 0.0;
      for (const Eigen::Vector3d& p : low)
        expected =
            std::max(expected, std::pow(reach - p.z(), 2.0) - (p.head<2>() - cell).squaredNorm());
      const double value =
          static_cast<double>(
              field.penumbra[static_cast<std::size_t>(row) * static_cast<std::size_t>(field.width) +
                             static_cast<std::size_t>(column)]) *
          field.cell * field.cell;
      greatest_error = std::max(greatest_error, std::abs(std::max(value, 0.0) - expected));
    }
    EXPECT_LT(greatest_error, 0.12 * reach * reach) << "trial " << trial;
  }
}

TEST(ContactShade, IsGreatestAtContact) {
  const auto model = box(0.04, 0.03, 0.02);
  const ShadowMesh mesh = make_shadow_mesh(*model);
  const ShadowKernels none{Eigen::Vector3d::UnitZ(), mesh.positions, {}};
  for (const double sunk : {0.0, 1e-6, 0.001, 0.012}) {
    const ShadowField field = contact_shade(
        place_caster(mesh, none, at(0.0, 0.0, 0.01 - sunk), PlaneFrame()), mesh.indices, 0.004);
    ASSERT_GT(field.cell, 0.0);
    const double greatest = static_cast<double>(*std::ranges::max_element(field.penumbra));
    EXPECT_NEAR(greatest * field.cell * field.cell / (0.004 * 0.004), 1.0, 0.1) << sunk;
  }
}

TEST(ContactShade, IsEmptyAboveItsReach) {
  const auto model = box(0.04, 0.03, 0.02);
  const ShadowMesh mesh = make_shadow_mesh(*model);
  const ShadowKernels none{Eigen::Vector3d::UnitZ(), mesh.positions, {}};
  const ShadowField field = contact_shade(
      place_caster(mesh, none, at(0.0, 0.0, 0.0141), PlaneFrame()), mesh.indices, 0.004);
  EXPECT_TRUE(std::ranges::none_of(field.penumbra, [](float value) { return value > 0.0F; }));
}

TEST(ContactShade, IgnoresFacesThatAreNotFinite) {
  std::vector<CasterVertex> vertices = {{0, 0, 0, 0, 0}, {0.01F, 0, 0, 0, 0}, {0, 0.01F, 0, 0, 0}};
  const std::vector<std::uint32_t> indices = {0, 1, 2, 0, 1, 3, 0, 1, 9};
  vertices.push_back({std::nanf(""), 0.01F, std::nanf(""), 0, 0});
  const ShadowField field = contact_shade(vertices, indices, 0.004);
  ASSERT_GT(field.cell, 0.0);
  EXPECT_TRUE(
      std::ranges::all_of(field.penumbra, [](float value) { return std::isfinite(value); }));
}

TEST(ContactShade, HasReachWithinLimits) {
  EXPECT_DOUBLE_EQ(contact_reach(0.0), 0.002);
  EXPECT_DOUBLE_EQ(contact_reach(0.1), 0.008);
  EXPECT_DOUBLE_EQ(contact_reach(5.0), 0.012);
}

PoseEstimate above() {
  return test::tracked(test::look_at({0.1, -0.35, 0.3}, {0.0, 0.0, 0.0}));
}
CameraModel camera(bool distorted = false) {
  return distorted ? test::distorted_camera(kSide, 500.0) : test::camera_of(kSide, kSide, 500.0);
}

// A box of 60 mm x 60 mm x 40 mm whose bottom is at a height; contact_reach() is 7.5 mm.
SceneBuilder scene_with_box(double bottom, ShadowTechnique technique, bool contact,
                            double x = 0.0) {
  SceneBuilder builder;
  ShadowNode& node = builder.scene().shadows[0];
  node.technique = technique;
  node.contact = contact;
  SceneLight lamp;
  lamp.position = {0.1, 0.2, 0.6};
  builder.scene().lights = {lamp};
  builder.add(box(0.06, 0.06, 0.04), at(x, 0.0, 0.02 + bottom, {0, 0, 1}, 0.3 + 8.0 * x));
  return builder;
}

RenderedImage drawn(const SceneBuilder& builder, const PlanOptions& options = {},
                    bool distorted = false) {
  Studio studio(builder.build(), camera(distorted));
  return studio.draw(test::plain_frame(kSide, kSide, kGrey), studio.plan(above(), options));
}

struct Difference {
  int pixels = 0, darkest = 0, brightest = 0;
};
Difference difference(const RenderedImage& image, const RenderedImage& base) {
  Difference result;
  for (std::size_t i = 0; i < image.rgba.size(); i += 4) {
    const int change = int{image.rgba[i]} - int{base.rgba[i]};
    result.pixels += change != 0 ? 1 : 0;
    result.darkest = std::min(result.darkest, change);
    result.brightest = std::max(result.brightest, change);
  }
  return result;
}

TEST(ContactShades, DarkenTheTableAroundRestingObjectsByEveryTechnique) {
  for (const auto& [technique, name] : kShadowTechniqueNames) {
    for (const bool distorted : {false, true}) {
      SCOPED_TRACE(std::string(name) + (distorted ? " distorted" : ""));
      const Difference shade =
          difference(drawn(scene_with_box(0.0, technique, true), {}, distorted),
                     drawn(scene_with_box(0.0, technique, false), {}, distorted));
      EXPECT_EQ(shade.brightest, 0);
      if (technique == ShadowTechnique::none) {
        EXPECT_EQ(shade.pixels, 0);
      } else {
        EXPECT_GT(shade.pixels, 400);
        EXPECT_LT(shade.pixels, 4'000);
        EXPECT_LT(shade.darkest, -20);
      }
    }
  }
}

TEST(ContactShades, FadeWithHeight) {
  int last_pixels = 1'000'000;
  for (const double bottom : {0.0, 0.002, 0.004, 0.006, 0.0076}) {
    SCOPED_TRACE(bottom);
    const Difference shade =
        difference(drawn(scene_with_box(bottom, ShadowTechnique::layered, true)),
                   drawn(scene_with_box(bottom, ShadowTechnique::layered, false)));
    EXPECT_LT(shade.pixels, last_pixels);
    last_pixels = shade.pixels;
  }
  EXPECT_EQ(last_pixels, 0);
}

TEST(ContactShades, AreOfVirtualObjectsOnly) {
  SceneBuilder builder = scene_with_box(0.0, ShadowTechnique::layered, true);
  builder.scene().objects[0].phantom = true;
  SceneBuilder without = scene_with_box(0.0, ShadowTechnique::layered, false);
  without.scene().objects[0].phantom = true;
  EXPECT_EQ(drawn(builder), drawn(without));
}

TEST(ContactShades, AreNotOnWalls) {
  SceneBuilder builder = scene_with_box(0.0, ShadowTechnique::walls, true);
  ScenePlane& wall = builder.scene().planes.emplace_back();
  wall.name = "wall";
  wall.normal = {0, -1, 0};
  wall.point = {0, 0.04, 0};  // the box touches it
  builder.scene().shadows[0].walls = {1};
  Studio studio(builder.build(), camera());
  const FramePlan plan = studio.plan(above());
  ASSERT_EQ(plan.receivers.size(), 2U);
  ASSERT_EQ(plan.contacts.size(), 1U);
  EXPECT_EQ(plan.contacts[0].plane, 0);
}

TEST(ContactShades, FollowSlidingObjectAsMadeAnew) {
  SceneBuilder moving = scene_with_box(0.0, ShadowTechnique::simple, true);
  Studio studio(moving.build(), camera());
  const Frame frame = test::plain_frame(kSide, kSide, kGrey);
  for (const double x : {0.0, 0.01, 0.023}) {
    SceneState state = evaluate_scene(studio.scene(), 0.0);
    state.objects[0] = at(x, 0.0, 0.02, {0, 0, 1}, 0.3 + 8.0 * x);
    for (const bool skip : {true, false}) {
      PlanOptions options;
      options.skip = skip;
      const RenderedImage image =
          studio.draw(frame, plan_frame(studio.scene(), state, above(), camera(), options));
      EXPECT_EQ(image, drawn(scene_with_box(0.0, ShadowTechnique::simple, true, x)))
          << "x " << x << ", skip " << skip;
    }
  }
}

TEST(ContactShades, AreRetexturedAsBlended) {
  PlanOptions options;
  options.translucency = Translucency::blend;
  const RenderedImage blended = drawn(scene_with_box(0.0, ShadowTechnique::simple, true), options);
  options.translucency = Translucency::retexture;
  const Difference change =
      difference(drawn(scene_with_box(0.0, ShadowTechnique::simple, true), options), blended);
  EXPECT_LE(std::max(-change.darkest, change.brightest), 1);
}

TEST(ContactShades, OfSeveralObjectsAreMultipliedInAnyOrder) {
  const auto two_boxes = [](bool reversed, Translucency mode) {
    SceneBuilder builder = scene_with_box(0.0, ShadowTechnique::none, true);
    builder.scene().shadows[0].technique = ShadowTechnique::simple;
    builder.scene().objects.clear();
    builder.scene().shadows[0].casters.clear();
    for (const double side : {-1.0, 1.0}) {
      const double x = (reversed ? -side : side) * 0.033;
      builder.add(box(0.06, 0.06, 0.04), at(x, 0.0, 0.02));
    }
    PlanOptions options;
    options.translucency = mode;
    return drawn(builder, options);
  };
  const RenderedImage blended = two_boxes(false, Translucency::blend);
  for (const auto& [reversed, mode] :
       {std::pair{true, Translucency::blend}, {false, Translucency::retexture}}) {
    const Difference change = difference(two_boxes(reversed, mode), blended);
    EXPECT_LE(std::max(-change.darkest, change.brightest), 2);
  }
}

TEST(ContactShades, BlackenPixelsInModeMesh) {
  PlanOptions options;
  options.translucency = Translucency::mesh;
  const RenderedImage with = drawn(scene_with_box(0.0, ShadowTechnique::simple, true), options);
  const RenderedImage without = drawn(scene_with_box(0.0, ShadowTechnique::simple, false), options);
  int black = 0;
  for (std::size_t i = 0; i < with.rgba.size(); i += 4) {
    if (with.rgba[i] == without.rgba[i]) continue;
    EXPECT_EQ(with.rgba[i], 0);
    ++black;
  }
  EXPECT_GT(black, 80);
}

}  // namespace
}  // namespace penumbra::contact_shade_test
