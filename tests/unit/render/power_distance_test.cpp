#include "render/shadow/fields/power_distance.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>

#include "render/shadow/casters/caster.hpp"
#include "support/field_sample.hpp"
#include "support/shadow_cases.hpp"
#include "support/shapes.hpp"

namespace penumbra {
namespace {

constexpr double kNoLimit = std::numeric_limits<double>::infinity();

ShadowField field_of(const ShadowMesh& mesh, const Placement& placement,
                     const LayeredConstants& constants, const ShadowFieldOptions& options = {}) {
  const PlaneFrame plane;
  const ShadowKernels none{plane.n, mesh.positions, {}};
  return power_distance_layers(
      place_caster(mesh, none, placement, plane), mesh.indices, mesh.part,
      part_lights(part_discs(mesh, up_in_object(placement, plane)), placement, plane), constants,
      options);
}

test::Mask mask_of(const ShadowField& field, ShadowLayer layer, double half, int pixels = 512) {
  test::Mask mask({-half, -half}, 2.0 * half / pixels, pixels);
  for (int row = 0; row < pixels; ++row)
    for (int column = 0; column < pixels; ++column)
      mask.bits[mask.index(column, row)] =
          test::field_at(field, layer,
                         mask.origin + mask.pixel * Eigen::Vector2d(column + 0.5, row + 0.5)) > 0.0F
              ? 1
              : 0;
  return mask;
}

// Ray-cast shadow of a convex mesh on a plane, lit by a disc light of radius R at height H above
// (0, 0): the pixels from which all points, any point or the centre of the light are hidden. Points
// of the light's rim suffice, because the part of the disc hidden by a convex caster is convex.
struct Truth {
  test::Mask all, any, centre;
};
Truth ray_cast(const ShadowMesh& mesh, const Placement& placement, double H, double R,
               double half) {
  const int pixels = 512;
  const test::Mask empty({-half, -half}, 2.0 * half / pixels, pixels);
  Truth truth{empty, empty, empty};
  std::fill(truth.all.bits.begin(), truth.all.bits.end(), std::uint8_t{1});
  constexpr int kRim = 128;
  for (int i = 0; i <= kRim; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / kRim;
    const Eigen::Vector2d light = i == kRim
                                      ? Eigen::Vector2d(0, 0)
                                      : Eigen::Vector2d(R * std::cos(angle), R * std::sin(angle));
    test::Mask shadow = empty;
    for (std::size_t f = 0; f < mesh.indices.size(); f += 3) {
      std::array<Eigen::Vector2d, 3> corners;
      for (std::size_t c = 0; c < 3; ++c) {
        const glm::vec3& q = mesh.positions[mesh.indices[f + c]];
        const Eigen::Vector3d p =
            placement * Eigen::Vector3d(static_cast<double>(q.x), static_cast<double>(q.y),
                                        static_cast<double>(q.z));
        corners[c] = light + (p.head<2>() - light) * (H / (H - p.z()));
      }
      shadow.cover_triangle(corners);
    }
    if (i == kRim) truth.centre = shadow;
    for (std::size_t b = 0; b < shadow.bits.size(); ++b) {
      truth.any.bits[b] = truth.any.bits[b] | shadow.bits[b];
      truth.all.bits[b] = truth.all.bits[b] & shadow.bits[b];
    }
  }
  return truth;
}

TEST(PowerDistance, MatchesRayCastShadowOfBox) {
  const ShadowMesh mesh = make_shadow_mesh(test::box_model(0.08));
  const Placement placement = {Eigen::Vector3d(0, 0, 0.12),
                               Eigen::Quaterniond(Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ())),
                               1.0};
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const ShadowField field = field_of(mesh, placement, constants);
  const Truth truth = ray_cast(mesh, placement, 0.9, 3.0 * 0.04, 0.12);
  const auto iou_with = [&](ShadowLayer layer, const test::Mask& expected) {
    return test::iou(mask_of(field, layer, 0.12).bits, expected.bits);
  };
  EXPECT_GT(iou_with(ShadowLayer::middle, truth.centre), 0.985);
  EXPECT_GT(iou_with(ShadowLayer::penumbra, truth.any), 0.98);
  EXPECT_GT(iou_with(ShadowLayer::umbra, truth.all), 0.95);
}

TEST(PowerDistance, MatchesRayCastShadowOfSphere) {
  test::ShapeBuilder shape;
  shape.sphere(0.05, 24, 48);
  const ShadowMesh mesh = make_shadow_mesh(shape.build());
  const Placement placement = {Eigen::Vector3d(0, 0, 0.15), Eigen::Quaterniond::Identity(), 1.0};
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const ShadowField field = field_of(mesh, placement, constants);
  const double radius = static_cast<double>(part_discs(mesh, Eigen::Vector3d::UnitZ())[0].radius);
  EXPECT_NEAR(radius, 0.05, 0.0008);
  const Truth truth = ray_cast(mesh, placement, 0.9, 3.0 * radius, 0.15);
  EXPECT_GT(test::iou(mask_of(field, ShadowLayer::middle, 0.15).bits, truth.centre.bits), 0.98);
  EXPECT_GT(test::iou(mask_of(field, ShadowLayer::penumbra, 0.15).bits, truth.any.bits), 0.975);
  EXPECT_GT(test::iou(mask_of(field, ShadowLayer::umbra, 0.15).bits, truth.all.bits), 0.94);
}

// The lower parts of these tilted casters add to the umbra of the upper parts.
TEST(PowerDistance, MatchesRayCastUmbraOfTiltedCasters) {
  test::ShapeBuilder cone;
  std::vector<std::uint32_t> ring;
  for (int i = 0; i < 40; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / 40;
    ring.push_back(cone.vertex(0.04 * std::cos(angle), 0.04 * std::sin(angle), 0.0));
  }
  const std::uint32_t tip = cone.vertex(0.0, 0.0, 0.06);
  const std::uint32_t foot = cone.vertex(0.0, 0.0, -0.03);
  for (std::size_t i = 0; i < 40; ++i) {
    cone.triangle(ring[i], ring[(i + 1) % 40], tip);
    cone.triangle(ring[(i + 1) % 40], ring[i], foot);
  }
  test::ShapeBuilder ball;
  ball.sphere(0.05, 24, 48);
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  int compared = 0;
  for (const Model& model : {test::box_model(0.08), cone.build(), ball.build()}) {
    const ShadowMesh mesh = make_shadow_mesh(model);
    for (const double tilt : {0.0, 0.7, 2.0}) {
      const Placement placement = {
          Eigen::Vector3d(0, 0, 0.12),
          Eigen::Quaterniond(Eigen::AngleAxisd(tilt, Eigen::Vector3d(1, 2, 0).normalized())), 1.0};
      const PlaneFrame plane;
      const PartLight light =
          part_lights(part_discs(mesh, up_in_object(placement, plane)), placement, plane)[0];
      // The reference requires a light above the origin.
      if (light.centre.norm() > 1e-3) continue;
      const Truth truth = ray_cast(mesh, placement, 0.9, 3.0 * light.radius, 0.12);
      const ShadowField field = field_of(mesh, placement, constants);
      EXPECT_GT(test::iou(mask_of(field, ShadowLayer::umbra, 0.12).bits, truth.all.bits), 0.97)
          << compared << " " << tilt;
      ++compared;
    }
  }
  EXPECT_GE(compared, 6);
}

TEST(PowerDistance, KeepsLightRadiiWithFewerCells) {
  // With coarser cells a radius changes by less than a quarter of a field cell.
  for (const ShadowMesh& mesh :
       {make_shadow_mesh(test::bush_model(60)), make_shadow_mesh(test::box_model(0.08))}) {
    for (const Eigen::Vector3d& up : {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0.3, -0.5, 0.8)}) {
      float extent = 0.0F;
      for (const glm::vec3& p : mesh.positions)
        extent = std::max({extent, std::abs(p.x), std::abs(p.y), std::abs(p.z)});
      const auto coarse = part_discs(mesh, up);
      const auto fine = part_discs(mesh, up, 0.0);
      ASSERT_EQ(coarse.size(), fine.size());
      for (std::size_t part = 0; part < fine.size(); ++part) {
        EXPECT_NEAR(coarse[part].radius, fine[part].radius, 0.25F * extent / 256.0F) << part;
      }
    }
  }
}

TEST(PowerDistance, JoinsLayersAtContactAndLosesUmbraWithHeight) {
  test::ShapeBuilder shape;
  shape.prism({{-0.05, -0.05}, {0.05, -0.05}, {0.05, 0.05}, {-0.05, 0.05}}, 0.0, 0.0);
  const ShadowMesh mesh = make_shadow_mesh(shape.build());
  for (const double H : {0.9, kNoLimit}) {
    const LayeredConstants constants = std::isinf(H) ? make_layered_constants(H, 0.0, 0.3).value()
                                                     : make_layered_constants(H, 3.0, 0.0).value();
    const ShadowField contact =
        field_of(mesh, {Eigen::Vector3d::Zero(), Eigen::Quaterniond::Identity(), 1.0}, constants);
    for (const ShadowLayer layer : kShadowLayers)
      EXPECT_NEAR(mask_of(contact, layer, 0.07).area(), 0.01, 1.3e-4);
    const ShadowField gone = field_of(
        mesh, {Eigen::Vector3d(0, 0, 0.31), Eigen::Quaterniond::Identity(), 1.0}, constants);
    EXPECT_EQ(mask_of(gone, ShadowLayer::umbra, 0.07).area(), 0.0);
    EXPECT_GT(mask_of(gone, ShadowLayer::middle, 0.1).area(), 0.0099);
  }
}

// A body that extends below the plane has no face in the plane, but its umbra must have no hole
// there. An open surface has no interior to fill.
TEST(PowerDistance, FillsUmbraOfBodyThatExtendsBelowPlane) {
  const LayeredConstants constants;
  const auto umbra = [&](const ShadowMesh& mesh, double z, double tilt) {
    const ShadowField field = field_of(
        mesh,
        {{0.0, 0.0, z}, Eigen::Quaterniond(Eigen::AngleAxisd(tilt, Eigen::Vector3d::UnitX())), 1.0},
        constants);
    return mask_of(field, ShadowLayer::umbra, 0.15).area();
  };
  test::ShapeBuilder cube_shape;
  cube_shape.box(-0.05, -0.05, -0.05, 0.05, 0.05, 0.05);
  const ShadowMesh cube = make_shadow_mesh(cube_shape.build());
  for (const double z : {0.05, 0.05 - 1e-9, 0.049, 0.03, 0.0, -0.03, -0.049}) {
    EXPECT_NEAR(umbra(cube, z, 0.0), 0.01, 4e-4) << z;
  }
  test::ShapeBuilder ring_shape;
  ring_shape.torus(0.06, 0.02, 24, 48);
  const ShadowMesh ring = make_shadow_mesh(ring_shape.build());
  const double full_area = umbra(ring, 0.02, 0.0);
  EXPECT_GT(full_area, 0.005);
  for (const double z : {0.019, 0.01, 0.0}) {
    EXPECT_GT(umbra(ring, z, 0.0), 0.9 * full_area) << z;
    EXPECT_LT(umbra(ring, z, 0.0), 1.2 * full_area) << z << ": the ring's hole must stay";
  }
  EXPECT_GT(umbra(cube, 0.02, 0.5), 0.009);
  ShadowMesh open = cube;  // the cube without the faces of one side
  open.indices.resize(open.indices.size() - 6);
  EXPECT_LT(umbra(open, 0.0, 0.0), 0.0105);
}

TEST(PowerDistance, KeepsEachLayerInsideLighterLayer) {
  const ShadowMesh mesh = make_shadow_mesh(test::bush_model(60));
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const ShadowField field =
      field_of(mesh, {Eigen::Vector3d(0, 0, 0.02), Eigen::Quaterniond::Identity(), 1.0}, constants);
  for (std::size_t i = 0; i < field.umbra.size(); ++i) {
    ASSERT_TRUE(field.umbra[i] <= 0.0F || field.middle[i] > 0.0F);
    ASSERT_TRUE(field.middle[i] <= 0.0F || field.penumbra[i] > 0.0F);
  }
}

// At each point, as many outline edges begin as end. The outlines' area equals that of the
// triangles.
TEST(PowerDistance, TracesClosedOutlinesAroundTriangles) {
  for (const double height : {0.02, 0.1, 0.2}) {
    const Placement placement{
        Eigen::Vector3d(0.01, 0.02, height),
        Eigen::Quaterniond(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 0.3, 0.2).normalized())), 1.0};
    const ShadowField field =
        field_of(make_shadow_mesh(test::bush_model(20)), placement, {0.6, 2.5, 0.24, 8.0});
    for (const ShadowLayer layer : kShadowLayers) {
      SCOPED_TRACE(height);
      const auto sides = field_outline(field, layer);
      const auto triangles = field_triangles(field, layer);
      ASSERT_EQ(sides.empty(), triangles.empty());
      std::map<std::pair<float, float>, int> balance;
      double outline_area = 0.0;
      const auto cross = [](const PlanePoint& a, const PlanePoint& b) {
        return 0.5 * (static_cast<double>(a.u) * static_cast<double>(b.v) -
                      static_cast<double>(b.u) * static_cast<double>(a.v));
      };
      for (const OutlineSide& side : sides) {
        ++balance[{side.from.u, side.from.v}];
        --balance[{side.to.u, side.to.v}];
        outline_area += cross(side.from, side.to);
      }
      for (const auto& [point, count] : balance) EXPECT_EQ(count, 0);
      double area = 0.0;
      for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
        area += cross(triangles[i], triangles[i + 1]) + cross(triangles[i + 1], triangles[i + 2]) +
                cross(triangles[i + 2], triangles[i]);
      }
      EXPECT_NEAR(outline_area, area, 1e-9);
      if (layer == ShadowLayer::penumbra) {
        EXPECT_GT(outline_area, 1e-3);
      }
    }
  }
  ShadowField none;
  EXPECT_TRUE(field_outline(none, ShadowLayer::umbra).empty());
}

TEST(PowerDistance, AcceptsEmptyAndInvalidInput) {
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  EXPECT_EQ(power_distance_layers({}, {}, {}, {}, constants).width, 0);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const std::vector<CasterVertex> vertices = {{0, 0, 0.1F, 0, 0},    {0.1F, 0, 0.1F, 0, 0},
                                              {0, 0.1F, 0.1F, 0, 0}, {nan, 0, 0.1F, 0, 0},
                                              {0, 0, -1.0F, 0, 0},   {3e38F, 0, 0.1F, 0, 0}};
  const std::vector<std::uint32_t> part(vertices.size(), 0);
  const std::vector<PartLight> lights = {{Eigen::Vector2d::Zero(), 0.03}};
  for (const std::vector<std::uint32_t>& indices : {std::vector<std::uint32_t>{0, 1, 2},
                                                    {0, 1, 3},
                                                    {0, 0, 0},
                                                    {4, 4, 4},
                                                    {0, 1, 5},
                                                    {0, 1, 99},
                                                    {0, 1, 4}}) {
    const ShadowField field = power_distance_layers(vertices, indices, part, lights, constants);
    for (const ShadowLayer layer : kShadowLayers)
      for (const float value : field.layer(layer)) ASSERT_FALSE(std::isnan(value));
    EXPECT_EQ(test::field_at(field, ShadowLayer::umbra, {1e9, 0.0}), -1.0F);
  }
}

}  // namespace
}  // namespace penumbra
