// Properties of layers and kernels for random casters, poses, planes and constants.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <random>

#include "render/shadow/casters/caster_geometry.hpp"
#include "render/shadow/fields/fixed_light.hpp"
#include "render/shadow/kernels/twist.hpp"
#include "render/shadow/layers/layer_polygons.hpp"
#include "render/shadow/projected/projected_shadow.hpp"
#include "support/kernel_distances.hpp"
#include "support/shadow_cases.hpp"
#include "support/shapes.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

double real(double low, double high) {
  return low + (high - low) * (static_cast<double>(*rc::gen::inRange(0, 1000001)) * 1e-6);
}
float real_f(double low, double high) {
  return static_cast<float>(real(low, high));
}

LayeredConstants any_constants() {
  const double h_u = real(0.05, 1.0);
  if (*rc::gen::inRange(0, 5) == 0) return make_layered_constants(kInfinity, 0.0, h_u).value();
  const double a = real(0.3, 8.0);
  return make_layered_constants(a * h_u, a, 0.0).value();
}

PlaneFrame any_plane(double distance) {
  Eigen::Vector3d n(real(-1, 1), real(-1, 1), real(-1, 1));
  if (n.norm() < 0.1) n = Eigen::Vector3d::UnitZ();
  return PlaneFrame::make(n, Eigen::Vector3d(real(-distance, distance), real(-distance, distance),
                                             real(-distance, distance)));
}

// Returns a random triangle soup. Some faces are slivers, points, repeated or unconnected.
Model any_soup(double size) {
  Model model;
  Mesh& mesh = model.meshes.emplace_back();
  const int vertices = *rc::gen::inRange(1, 40);
  for (int i = 0; i < vertices; ++i) {
    const int kind = *rc::gen::inRange(0, 6);
    if (kind == 0 && !mesh.positions.empty()) {
      glm::vec3 p = mesh.positions.back();
      p.x += static_cast<float>(size * 1e-5);
      mesh.positions.push_back(p);
    } else {
      mesh.positions.emplace_back(real_f(-size, size), real_f(-size, size),
                                  kind == 1 ? 0.0F : real_f(-size, size));
    }
    mesh.source_vertex.push_back(static_cast<std::uint32_t>(i));
  }
  const int faces = *rc::gen::inRange(0, 40);
  for (int i = 0; i < 3 * faces; ++i)
    mesh.indices.push_back(static_cast<std::uint32_t>(*rc::gen::inRange(0, vertices)));
  model.source_vertex_count = static_cast<std::uint32_t>(vertices);
  return model;
}

bool finite(const glm::vec3& p) {
  return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z);
}

Eigen::Quaterniond any_rotation() {
  const Eigen::Quaterniond q(real(-1, 1), real(-1, 1), real(-1, 1), real(-1, 1));
  return q.norm() > 0.1 ? q.normalized() : Eigen::Quaterniond::Identity();
}

// Returns limbs and boxes in random directions, overlapping or separate. Unlike a soup, these
// closed parts have a thickness.
Model any_body() {
  test::ShapeBuilder shape;
  const int pieces = *rc::gen::inRange(1, 5);
  for (int i = 0; i < pieces; ++i) {
    const double x = real(-0.06, 0.06);
    const double y = real(-0.06, 0.06);
    if (*rc::gen::inRange(0, 3) == 0) {
      shape.box(x, y, real(-0.05, 0.0), x + real(0.01, 0.06), y + real(0.01, 0.06),
                real(0.01, 0.05));
    } else {
      shape.limb({x, y, real(-0.07, -0.02)},
                 {real(-0.06, 0.06), real(-0.06, 0.06), real(0.02, 0.07)}, real(0.004, 0.02),
                 real(0.004, 0.02), *rc::gen::inRange(3, 12));
    }
  }
  return shape.build();
}

double area_of(const std::vector<PlanePoint>& triangles) {
  const auto outline = union_of_triangles(triangles);
  if (!outline) RC_FAIL(outline.error().message);
  return outline->area;
}

double area_at(const ShadowField& field, ShadowLayer layer) {
  return union_of_triangles(field_triangles(field, layer)).value().area;
}

RC_GTEST_PROP(LayerFactors, StayWithinErrorBoundInFloat, ()) {
  const LayeredConstants given = any_constants();
  LayeredConstants constants = given;
  constants.light_height = static_cast<double>(static_cast<float>(given.light_height));
  constants.light_ratio = static_cast<double>(static_cast<float>(given.light_ratio));
  if (!std::isinf(given.light_height))
    constants.umbra_height = constants.light_height / constants.light_ratio;
  for (const ShadowLayer layer : kShadowLayers) {
    const double high = std::min(layer_height_range(constants, layer).high, 3.0);
    // Heights cover the whole range and lie close to both ends.
    const double where = real(0.0, 1.0);
    const int kind = *rc::gen::inRange(0, 3);
    const auto h = static_cast<float>(kind == 0   ? where * high
                                      : kind == 1 ? high * (1.0 - 1e-6 * where)
                                                  : high * 1e-6 * where);
    const auto H = static_cast<long double>(constants.light_height);
    const auto a = static_cast<long double>(constants.light_ratio);
    const auto exact_h = static_cast<long double>(h);
    if (static_cast<double>(h) > high) continue;  // rounded beyond the end of the range
    const long double exact =
        std::isinf(constants.light_height)
            ? 1.0L + lambda_of(layer) * exact_h / static_cast<long double>(constants.umbra_height)
            : (H + lambda_of(layer) * a * exact_h) / (H - exact_h);
    const double bound =
        4e-7 * (1.0 + std::abs(static_cast<double>(exact))) *
        (std::isinf(constants.light_height) ? 1.0 : static_cast<double>(H / (H - exact_h)));
    RC_ASSERT(std::abs(static_cast<double>(layer_factor_f(constants, layer, h)) -
                       static_cast<double>(exact)) <= bound);
    RC_ASSERT(std::abs(layer_factor(constants, layer, static_cast<double>(h)) -
                       static_cast<double>(exact)) <= 1e-6 * bound);
  }
}

RC_GTEST_PROP(LayerFactors, AreOrderedAndMonotonic, ()) {
  const LayeredConstants constants = any_constants();
  const double top = std::min(layer_height_range(constants, ShadowLayer::middle).high, 10.0);
  double before[3] = {1.0, 1.0, 1.0};
  for (int step = 0; step <= 50; ++step) {
    const double h = top * step / 50.0;
    const double u = layer_factor(constants, ShadowLayer::umbra, h);
    const double m = layer_factor(constants, ShadowLayer::middle, h);
    const double p = layer_factor(constants, ShadowLayer::penumbra, h);
    RC_ASSERT(0.0 <= u && u <= m && m <= p && std::isfinite(p));
    if (constants.light_ratio >= 1.0) RC_ASSERT(u <= before[0] + 1e-12);
    RC_ASSERT(m >= before[1] && p >= before[2]);
    before[0] = u;
    before[1] = m;
    before[2] = p;
  }
}

RC_GTEST_PROP(LayerFactors, ApproachLimitsAtContactUmbraHeightAndZenith, ()) {
  const double h_u = real(0.1, 1.0);
  const double a = real(1.5, 8.0);
  const LayeredConstants constants = make_layered_constants(a * h_u, a, 0.0).value();
  // h -> 0: the factor changes by (1 + lambda a) / H per metre.
  for (const ShadowLayer layer : kShadowLayers) {
    const double h = 1e-7 * h_u;
    const double rate = (layer_factor(constants, layer, h) - 1.0) / h;
    const double expected = (1.0 + lambda_of(layer) * a) / (a * h_u);
    RC_ASSERT(std::abs(rate - expected) < 1e-5 * (1.0 + std::abs(expected)) / h_u);
  }
  // h -> h_u
  RC_ASSERT(layer_factor(constants, ShadowLayer::umbra, h_u * (1.0 - 1e-9)) < 1e-7);
  RC_ASSERT(layer_factor(constants, ShadowLayer::umbra, constants.umbra_height) == 0.0);
  // h -> H: the cap, which is finite and positive
  for (const double h : {a * h_u, a * h_u * (1.0 + 1e-12), 2.0 * a * h_u, 1e9}) {
    const double m = layer_factor(constants, ShadowLayer::middle, h);
    RC_ASSERT(std::abs(m - 8.0) < 1e-9);
  }
  // a -> 1: h_u -> H, and the umbra keeps its size
  const LayeredConstants equal = make_layered_constants(h_u, 1.0, 0.0).value();
  RC_ASSERT(std::abs(layer_factor(equal, ShadowLayer::umbra, 0.7 * h_u) - 1.0) < 1e-12);
  // H -> infinity with fixed h_u: the rates at the zenith
  const LayeredConstants zenith = make_layered_constants(kInfinity, 0.0, h_u).value();
  const LayeredConstants high = make_layered_constants(1e7 * h_u, 0.0, h_u).value();
  for (const ShadowLayer layer : kShadowLayers) {
    const double h = real(0.0, 1.0) * h_u;
    RC_ASSERT(std::abs(layer_factor(zenith, layer, h) - layer_factor(high, layer, h)) < 1e-6);
  }
}

RC_GTEST_PROP(LayerProperties, AcceptTriangleSoupOfAnySize, ()) {
  const double size = std::pow(10.0, real(-4.0, 4.0));
  const ShadowMesh mesh = make_shadow_mesh(any_soup(size));
  const PlaneFrame plane = any_plane(*rc::gen::inRange(0, 2) == 0 ? 0.1 : 100.0);
  const Placement placement = {
      plane.q + size * Eigen::Vector3d(real(-1, 1), real(-1, 1), real(-1, 1)), any_rotation(),
      std::pow(10.0, real(-1.0, 1.0))};
  const LayeredConstants constants = any_constants();
  const auto source = kKernelSourceNames[static_cast<std::size_t>(*rc::gen::inRange(0, 4))].value;
  const ShadowKernels kernels = generate_kernels(mesh, up_in_object(placement, plane), source);
  RC_ASSERT(kernels.kernels.size() == mesh.positions.size());
  for (const glm::vec3& k : kernels.kernels) RC_ASSERT(finite(k));
  const auto vertices = place_caster(mesh, kernels, placement, plane);
  for (const ShadowLayer layer : kShadowLayers) {
    const auto triangles = layer_triangles(vertices, mesh.indices, constants, layer);
    for (const PlanePoint& p : triangles) RC_ASSERT(std::isfinite(p.u) && std::isfinite(p.v));
    RC_ASSERT(area_of(triangles) >= -1e-12);
  }
  const TwistReport twists = find_twists(vertices, mesh.indices, 0.05, 1.65);
  RC_ASSERT(twists.faces_twisted <= twists.faces_tested);
  RC_ASSERT(0.0 <= twists.area_share && twists.area_share <= 1.0);
  const double overshoot = layer_overshoot(mesh, kernels, real(1.0, 3.0));
  RC_ASSERT(0.0 <= overshoot && overshoot <= 1.0);
}

RC_GTEST_PROP(LayerProperties, IgnoreNonFiniteVertices, ()) {
  Model model = any_soup(0.1);
  auto& positions = model.meshes[0].positions;
  const auto victim =
      static_cast<std::size_t>(*rc::gen::inRange(0, static_cast<int>(positions.size())));
  const float bad[] = {std::numeric_limits<float>::quiet_NaN(),
                       std::numeric_limits<float>::infinity(),
                       -std::numeric_limits<float>::infinity()};
  positions[victim].y = bad[*rc::gen::inRange(0, 3)];
  const ShadowMesh mesh = make_shadow_mesh(model);
  for (const glm::vec3& p : mesh.positions) RC_ASSERT(finite(p));
  RC_ASSERT(mesh.from_source[victim] == kNoShadowPosition);
  // Layers must ignore such vertices as well.
  std::vector<CasterVertex> vertices(6, CasterVertex{0.0F, 0.1F, 0.05F, 0.0F, 0.0F});
  vertices[1].u = 0.3F;
  vertices[2].v = 0.4F;
  float* fields[] = {&vertices[4].u, &vertices[4].v, &vertices[4].h, &vertices[4].ku,
                     &vertices[4].kv};
  *fields[*rc::gen::inRange(0, 5)] = bad[*rc::gen::inRange(0, 3)];
  const std::vector<std::uint32_t> indices = {0, 1, 2, 3, 4, 5};
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  RC_ASSERT(layer_triangles(vertices, indices, constants, ShadowLayer::middle).size() == 3U);
}

RC_GTEST_PROP(LayerProperties, AreEquivariantUnderTranslationAndYaw, ()) {
  const ShadowMesh mesh = make_shadow_mesh(any_soup(0.1));
  const LayeredConstants constants = any_constants();
  const PlaneFrame plane;
  const Placement before = {Eigen::Vector3d(0, 0, real(0.0, 0.3)), any_rotation(), 1.0};
  const double yaw = real(-3.0, 3.0);
  const Eigen::Vector3d slide(real(-1, 1), real(-1, 1), 0.0);
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()));
  const Placement after = {turn * before.position + slide, turn * before.rotation, 1.0};
  // The up direction in the object frame is unchanged, and therefore the kernels are.
  const Eigen::Vector3d up = up_in_object(before, plane);
  RC_ASSERT((up - up_in_object(after, plane)).norm() < 1e-12);
  const ShadowKernels kernels = generate_kernels(mesh, up, KernelSource::automatic);
  const auto a = place_caster(mesh, kernels, before, plane);
  const auto b = place_caster(mesh, kernels, after, plane);
  for (const ShadowLayer layer : kShadowLayers) {
    const double scale = layer_factor(constants, layer, 0.5);
    for (std::size_t i = 0; i < a.size(); ++i) {
      const PlanePoint p = project_to_layer(a[i], constants, layer);
      const PlanePoint q = project_to_layer(b[i], constants, layer);
      const Eigen::Vector3d expected =
          turn * Eigen::Vector3d(static_cast<double>(p.u), static_cast<double>(p.v), 0.0) + slide;
      RC_ASSERT(std::hypot(expected.x() - static_cast<double>(q.u),
                           expected.y() - static_cast<double>(q.v)) < 1e-6 * (1.0 + scale));
    }
  }
}

// The layers of a level star-shaped footprint nest if its centre is the kernel.
RC_GTEST_PROP(LayerProperties, NestForStarShapedFootprint, ()) {
  std::vector<CasterVertex> vertices = {{0.0F, 0.0F, 0.0F, 0.0F, 0.0F}};
  std::vector<std::uint32_t> indices;
  const int corners = *rc::gen::inRange(5, 20);
  const LayeredConstants constants = any_constants();
  const float h = real_f(0.0, 0.99 * constants.umbra_height);
  for (int i = 0; i < corners; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / corners;
    const double r = real(0.02, 0.1);
    vertices.push_back({static_cast<float>(r * std::cos(angle)),
                        static_cast<float>(r * std::sin(angle)), h, 0.0F, 0.0F});
    indices.insert(indices.end(), {0U, static_cast<std::uint32_t>(i + 1),
                                   static_cast<std::uint32_t>((i + 1) % corners + 1)});
  }
  vertices[0].h = h;
  double area[3];
  for (std::size_t i = 0; i < 3; ++i) {
    const auto outline =
        union_of_triangles(layer_triangles(vertices, indices, constants, kShadowLayers[i]));
    RC_ASSERT(outline.has_value());
    area[i] = outline->area;
  }
  // The union of two nested layers must equal the outer one.
  for (std::size_t i = 0; i + 1 < 3; ++i) {
    auto both = layer_triangles(vertices, indices, constants, kShadowLayers[i]);
    const auto outer = layer_triangles(vertices, indices, constants, kShadowLayers[i + 1]);
    both.insert(both.end(), outer.begin(), outer.end());
    const auto outline = union_of_triangles(both);
    RC_ASSERT(outline.has_value());
    RC_ASSERT(std::abs(outline->area - area[i + 1]) <= 1e-5 * area[i + 1] + 1e-10);
  }
}

// Compares drawn layers with the formulas in long double on the given vertices, at any distance of
// the plane from the origin. The error is bounded by that of the factor (equation 2.11) plus the
// rounding of the coordinates.
RC_GTEST_PROP(LayerProperties, MatchExactLayersInFloat, ()) {
  const ShadowMesh mesh = make_shadow_mesh(any_soup(0.1));
  LayeredConstants constants = any_constants();
  if (!std::isinf(constants.light_height)) {
    constants.light_height = static_cast<double>(static_cast<float>(constants.light_height));
    constants.light_ratio = static_cast<double>(static_cast<float>(constants.light_ratio));
    constants.umbra_height = constants.light_height / constants.light_ratio;
  }
  const PlaneFrame plane = any_plane(*rc::gen::inRange(0, 2) == 0 ? 0.1 : 100.0);
  const Placement placement = {
      plane.q + real(0.0, 0.4) * plane.n + real(-0.3, 0.3) * plane.e1 + real(-0.3, 0.3) * plane.e2,
      any_rotation(), 1.0};
  const ShadowKernels kernels =
      generate_kernels(mesh, up_in_object(placement, plane), KernelSource::automatic);
  const auto vertices = place_caster(mesh, kernels, placement, plane);
  const auto exact = [&](const glm::vec3& p) {
    return plane.to_plane(placement * Eigen::Vector3d(static_cast<double>(p.x),
                                                      static_cast<double>(p.y),
                                                      static_cast<double>(p.z)));
  };
  constexpr double kUlp = 6e-8;  // relative rounding error of a float
  for (std::size_t layer = 0; layer < 3; ++layer) {
    const HeightRange range = layer_height_range(constants, kShadowLayers[layer]);
    for (std::size_t i = 0; i < vertices.size(); ++i) {
      const Eigen::Vector3d x = exact(mesh.positions[i]);
      const Eigen::Vector3d k = exact(kernels.kernels[i]);
      // Rounding may move a height across a nearby clip height.
      if (x.z() < 1e-6 || x.z() > range.high - 1e-6) continue;
      const double s = layer_factor(constants, kShadowLayers[layer], x.z());
      const Eigen::Vector2d expected = k.head<2>() + s * (x - k).head<2>();
      const double H = constants.light_height;
      const double steep = std::isinf(H) ? 1.0 : H / (H - x.z());
      const double slope = std::isinf(H) ? 1.0 / constants.umbra_height
                                         : (1.0 + constants.light_ratio) * steep / (H - x.z());
      const double distance = (x - k).head<2>().norm();
      const double size = 1.0 + x.head<2>().norm() + k.head<2>().norm();
      const double bound =
          4e-7 * (1.0 + std::abs(s)) * steep * distance +  // error of s, equation 2.11
          4.0 * kUlp * slope * distance +                  // rounding of h
          8.0 * kUlp * (1.0 + s) * size;                   // rounding of u, v, k
      const PlanePoint one = project_to_layer(vertices[i], constants, kShadowLayers[layer]);
      RC_ASSERT((Eigen::Vector2d(static_cast<double>(one.u), static_cast<double>(one.v)) - expected)
                    .norm() <= bound);
    }
  }
}

// Tests limits of whole layers; LayerFactors tests the same limits of the factors.
RC_GTEST_PROP(LayerProperties, ApproachLimitsAtContactUmbraHeightAndZenith, ()) {
  const double h_u = real(0.2, 0.5);
  const double a = real(1.5, 6.0);
  const LayeredConstants constants = make_layered_constants(a * h_u, a, 0.0).value();
  // For a level, flat body all vertices have one height.
  Model model = any_body();
  for (glm::vec3& p : model.meshes[0].positions) p.z = 0.0F;
  const ShadowMesh mesh = make_shadow_mesh(model);
  const ShadowKernels kernels =
      generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  const auto layers_at = [&](const LayeredConstants& with, double h, ShadowLayer layer) {
    const auto vertices =
        place_caster(mesh, kernels, {Eigen::Vector3d(0, 0, h), Eigen::Quaterniond::Identity(), 1.0},
                     PlaneFrame());
    return layer_triangles(vertices, mesh.indices, with, layer);
  };
  const double footprint = area_of(orthogonal_triangles(
      place_caster(mesh, kernels, {Eigen::Vector3d(0, 0, 0.1), Eigen::Quaterniond::Identity(), 1.0},
                   PlaneFrame()),
      mesh.indices));
  if (footprint < 1e-5) return;
  for (const ShadowLayer layer : kShadowLayers) {
    // h = 0 and h -> 0: in contact every layer equals the orthogonal shadow.
    RC_ASSERT(std::abs(area_of(layers_at(constants, 0.0, layer)) - footprint) < 1e-5 * footprint);
    RC_ASSERT(std::abs(area_of(layers_at(constants, 1e-6, layer)) - footprint) < 1e-3 * footprint);
    // Below the plane there is no layer. At and above the light the cap prevents an antishadow.
    RC_ASSERT(layers_at(constants, -1e-6, layer).empty());
    RC_ASSERT(layers_at(constants, a * h_u, layer).empty());
    RC_ASSERT(layers_at(constants, 2.0 * a * h_u, layer).empty());
    // H -> infinity with fixed h_u: the limit at the zenith.
    const double h = real(0.05, 0.9) * h_u;
    const double zenith =
        area_of(layers_at(make_layered_constants(kInfinity, 0.0, h_u).value(), h, layer));
    const double high =
        area_of(layers_at(make_layered_constants(1e6 * h_u, 0.0, h_u).value(), h, layer));
    RC_ASSERT(std::abs(zenith - high) < 1e-3 * footprint);
  }
  // h -> h_u from below: the umbra shrinks onto its kernels, which have no area for one kernel per
  // part. At h_u it vanishes.
  const ShadowKernels single =
      generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::centroid);
  const auto nearly = place_caster(
      mesh, single, {Eigen::Vector3d(0, 0, 0.999 * h_u), Eigen::Quaterniond::Identity(), 1.0},
      PlaneFrame());
  RC_ASSERT(area_of(layer_triangles(nearly, mesh.indices, constants, ShadowLayer::umbra)) <
            1e-5 * footprint);
  RC_ASSERT(layers_at(constants, 1.0001 * h_u, ShadowLayer::umbra).empty());
  // a -> 1: the umbra keeps the object's size, continuously from both sides of 1.
  const double h = 0.5 * h_u;
  const double same =
      area_of(layers_at(make_layered_constants(h_u, 1.0, 0.0).value(), h, ShadowLayer::umbra));
  RC_ASSERT(std::abs(same - footprint) < 1e-4 * footprint);
  for (const double ratio : {1.0 - 1e-6, 1.0 + 1e-6}) {
    const double beside =
        area_of(layers_at(make_layered_constants(h_u, ratio, 0.0).value(), h, ShadowLayer::umbra));
    RC_ASSERT(std::abs(beside - same) < 1e-4 * footprint);
  }
}

// Degenerate faces and slivers must not add area to a layer, for any kernels.
RC_GTEST_PROP(LayerProperties, IgnoreSliversAndDegenerateFaces, ()) {
  const ShadowMesh mesh = make_shadow_mesh(any_body());
  const LayeredConstants constants = any_constants();
  const Placement placement = {Eigen::Vector3d(0, 0, real(0.0, 0.2)), any_rotation(), 1.0};
  const PlaneFrame plane;
  const ShadowKernels kernels =
      generate_kernels(mesh, up_in_object(placement, plane), KernelSource::automatic);
  auto vertices = place_caster(mesh, kernels, placement, plane);
  auto indices = mesh.indices;
  const auto count = static_cast<int>(vertices.size());
  for (int i = 0; i < 30; ++i) {
    const auto a = static_cast<std::uint32_t>(*rc::gen::inRange(0, count));
    const auto b = static_cast<std::uint32_t>(*rc::gen::inRange(0, count));
    switch (i % 3) {
      case 0:  // a point
        indices.insert(indices.end(), {a, a, a});
        break;
      case 1:  // an edge
        indices.insert(indices.end(), {a, b, b});
        break;
      default: {  // a sliver of 1e-9 m along an edge of a face
        const std::size_t face = a % (mesh.indices.size() / 3);
        const std::uint32_t p = mesh.indices[3 * face];
        const std::uint32_t q = mesh.indices[3 * face + 1];
        CasterVertex beside = vertices[p];
        beside.u += 1e-9F;
        vertices.push_back(beside);
        indices.insert(indices.end(), {p, q, static_cast<std::uint32_t>(vertices.size() - 1)});
      }
    }
  }
  for (const ShadowLayer layer : kShadowLayers) {
    const double without = area_of(layer_triangles(vertices, mesh.indices, constants, layer));
    const double with = area_of(layer_triangles(vertices, indices, constants, layer));
    RC_ASSERT(std::abs(with - without) <= 1e-7);
  }
}

// Fields, layers of fixed light and hard shadows accept any soup. The layers of a field nest.
RC_GTEST_PROP(ShadowTechniques, AcceptTriangleSoup, ()) {
  const double size = std::pow(10.0, real(-4.0, 4.0));
  const ShadowMesh mesh = make_shadow_mesh(any_soup(size));
  const PlaneFrame plane = any_plane(*rc::gen::inRange(0, 2) == 0 ? 0.1 : 100.0);
  const Placement placement = {
      plane.q + size * Eigen::Vector3d(real(-1, 1), real(-1, 1), real(-1, 1)), any_rotation(), 1.0};
  const LayeredConstants constants = any_constants();
  const Eigen::Vector3d up = up_in_object(placement, plane);
  const ShadowKernels kernels = generate_kernels(mesh, up, KernelSource::automatic);
  const auto vertices = place_caster(mesh, kernels, placement, plane);
  const auto parts = part_discs(mesh, up);
  RC_ASSERT(parts.size() == mesh.part_count);
  for (const PartDisc& part : parts)
    RC_ASSERT(finite(part.centre) && std::isfinite(part.radius) && part.radius >= 0.0F);

  const ShadowField field =
      power_distance_layers(vertices, mesh.indices, mesh.part, part_lights(parts, placement, plane),
                            constants, {.cells = 64});
  const std::size_t cells =
      static_cast<std::size_t>(field.width) * static_cast<std::size_t>(field.height);
  for (std::size_t i = 0; i < cells; ++i) {
    RC_ASSERT(std::isfinite(field.umbra[i]) && std::isfinite(field.middle[i]) &&
              std::isfinite(field.penumbra[i]));
    RC_ASSERT(!(field.umbra[i] > 0.0F) || field.middle[i] > 0.0F);
    RC_ASSERT(!(field.middle[i] > 0.0F) || field.penumbra[i] > 0.0F);
  }
  const auto discs = vertex_discs(mesh, kernels, parts, placement.scale);
  for (const ShadowLayer layer : kShadowLayers) {
    for (const PlanePoint& p : field_triangles(field, layer))
      RC_ASSERT(std::isfinite(p.u) && std::isfinite(p.v));
    for (const PlanePoint& p :
         fixed_light_triangles(vertices, discs, mesh.indices, constants, layer))
      RC_ASSERT(std::isfinite(p.u) && std::isfinite(p.v));
  }
  const Eigen::Vector3d above = plane.q + size * real(-1.0, 3.0) * plane.n;
  for (const PlanePoint& p : projected_triangles(
           vertices, mesh.indices, Eigen::Vector4d(above.x(), above.y(), above.z(), 1), plane))
    RC_ASSERT(std::isfinite(p.u) && std::isfinite(p.v));
}

// Returns a ring of any shape and orientation, whose round outline has hundreds of vertices.
Model any_ring() {
  test::ShapeBuilder shape;
  shape.torus(real(0.03, 0.06), real(0.005, 0.02), *rc::gen::inRange(8, 20),
              *rc::gen::inRange(16, 40));
  Model model = shape.build();
  Eigen::Matrix3d shear = Eigen::Matrix3d::Identity();
  shear(0, 0) = real(0.5, 1.5);
  shear(0, 1) = real(-0.5, 0.5);
  test::transform(model, any_rotation().toRotationMatrix() * shear, Eigen::Vector3d::Zero());
  return model;
}

// Moves each coordinate to an adjacent float, or leaves it.
Model rounded_otherwise(Model model, std::mt19937& random) {
  for (glm::vec3& p : model.meshes[0].positions) {
    for (int i = 0; i < 3; ++i) {
      const auto direction = random() % 3;
      if (direction != 0) p[i] = std::nextafter(p[i], direction == 1 ? 1.0F : -1.0F);
    }
  }
  return model;
}

// Kernels generated for a body rotated about the plane's normal must be the rotated kernels, and
// the layers must rotate too (docs/shadows.md#kernels, rule 2, and 2.10). If several discs have the
// same size and distance, rounding decides which disc is used; the comparison allows each of them.
RC_GTEST_PROP(GeneratedKernels, RotateWithBody, ()) {
  const Model model = *rc::gen::inRange(0, 4) == 0 ? any_ring() : any_body();
  const Eigen::Vector3d up = Eigen::Vector3d(real(-0.5, 0.5), real(-0.5, 0.5), 1.0).normalized();
  const Eigen::Matrix3d R = Eigen::AngleAxisd(real(-3.0, 3.0), up).toRotationMatrix();
  Model turned = model;
  test::transform(turned, R, Eigen::Vector3d::Zero());
  const ShadowMesh mesh = make_shadow_mesh(model);
  const ShadowMesh turned_mesh = make_shadow_mesh(turned);
  RC_ASSERT(mesh.positions.size() == turned_mesh.positions.size());
  const ShadowKernels kernels = generate_kernels(mesh, up, KernelSource::automatic);
  const ShadowKernels after = generate_kernels(turned_mesh, up, KernelSource::automatic);

  const auto exact = [](const glm::vec3& p) {
    return Eigen::Vector3d(static_cast<double>(p.x), static_cast<double>(p.y),
                           static_cast<double>(p.z));
  };
  double size = 0.0;
  for (const glm::vec3& p : mesh.positions)
    size = std::max(size, (exact(p) - exact(mesh.positions[0])).norm());
  // A raster is aligned with an edge of at least 1 % of a part's size, so the raster's direction is
  // accurate to some hundred rounding errors.
  const double allowed = 1e-5 * size;
  const auto off = [&](const ShadowKernels& before, std::size_t i) {
    const Eigen::Vector3d d = exact(after.kernels[i]) - R * exact(before.kernels[i]);
    return (d - d.dot(up) * up).norm();
  };
  std::vector<std::size_t> chosen_otherwise;
  for (std::size_t i = 0; i < mesh.positions.size(); ++i)
    if (off(kernels, i) > allowed) chosen_otherwise.push_back(i);
  if (!chosen_otherwise.empty()) {
    std::mt19937 random(7);
    for (int attempt = 0; attempt < 300 && !chosen_otherwise.empty(); ++attempt) {
      const ShadowKernels other = generate_kernels(
          make_shadow_mesh(rounded_otherwise(model, random)), up, KernelSource::automatic);
      std::erase_if(chosen_otherwise, [&](std::size_t i) { return off(other, i) <= allowed; });
    }
    RC_ASSERT(chosen_otherwise.empty());
    return;  // ambiguous kernels, so the layers may differ
  }

  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const PlaneFrame plane = PlaneFrame::make(up, -0.12 * up);
  const Placement placement;
  const auto vertices = place_caster(mesh, kernels, placement, plane);
  const auto turned_vertices = place_caster(turned_mesh, after, placement, plane);
  for (const ShadowLayer layer : kShadowLayers) {
    const auto triangles = layer_triangles(vertices, mesh.indices, constants, layer);
    // The outline is at most as long as the sum of all edges, and no point moves by more than
    // `moved`.
    double edges = 0.0;
    for (std::size_t i = 0; i < triangles.size(); ++i) {
      const PlanePoint& p = triangles[i];
      const PlanePoint& q = triangles[i % 3 == 2 ? i - 2 : i + 1];
      edges += std::hypot(static_cast<double>(p.u) - static_cast<double>(q.u),
                          static_cast<double>(p.v) - static_cast<double>(q.v));
    }
    const double moved =
        (1.0 + std::abs(layer_factor(constants, layer, 0.3))) * (allowed + 1e-6 * size);
    const double before = area_of(triangles);
    const double then =
        area_of(layer_triangles(turned_vertices, turned_mesh.indices, constants, layer));
    RC_ASSERT(std::abs(before - then) <= edges * moved);
  }
}

// One micrometre of height must change a layer only slightly, also where vertices cross the plane,
// the umbra height or the cap. The body is tilted, because a level face appears at once when it
// crosses the plane.
RC_GTEST_PROP(LayerProperties, ChangeContinuouslyWithHeight, ()) {
  const ShadowMesh mesh = make_shadow_mesh(any_body());
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const Eigen::Quaterniond tilt(
      Eigen::AngleAxisd(real(0.3, 1.2), Eigen::Vector3d(real(-1, 1), 1.0, 0.0).normalized()));
  const PlaneFrame plane;
  const ShadowKernels kernels = generate_kernels(
      mesh, up_in_object({Eigen::Vector3d::Zero(), tilt, 1.0}, plane), KernelSource::automatic);
  // In half of the trials, a vertex crosses one of these heights exactly.
  double start = real(-0.1, 0.9);
  if (*rc::gen::inRange(0, 2) == 0) {
    const glm::vec3& p = mesh.positions[static_cast<std::size_t>(
        *rc::gen::inRange(0, static_cast<int>(mesh.positions.size())))];
    const double passes[] = {0.0, constants.umbra_height,
                             layer_height_range(constants, ShadowLayer::middle).high};
    start = passes[*rc::gen::inRange(0, 3)] -
            (tilt * Eigen::Vector3d(static_cast<double>(p.x), static_cast<double>(p.y),
                                    static_cast<double>(p.z)))
                .z();
  }
  constexpr double kStep = 1e-6;
  double area[2][3];
  for (std::size_t side = 0; side < 2; ++side) {
    const Placement placement = {
        Eigen::Vector3d(0, 0, start + kStep * (static_cast<double>(side) - 0.5)), tilt, 1.0};
    const auto vertices = place_caster(mesh, kernels, placement, plane);
    for (std::size_t i = 0; i < 3; ++i)
      area[side][i] = area_of(layer_triangles(vertices, mesh.indices, constants, kShadowLayers[i]));
  }
  for (std::size_t i = 0; i < 3; ++i) {
    // A face of at most 0.1 m by 0.1 m is inclined by at least 17 degrees. Where it is clipped at
    // the cap, it is magnified up to 8 times (middle layer) or 32 times (penumbra). Along the face,
    // a micrometre of height is at most 4 um.
    const double longest = 0.3 * (i == 0 ? 1.0 : i == 1 ? 8.0 : 32.0);
    RC_ASSERT(std::abs(area[1][i] - area[0][i]) <= 8.0 * kStep * longest * longest / 0.1 + 1e-8);
  }
}

// An inclined bar rises through the plane and the umbra height. Per millimetre, a layer may change
// by at most 1 % of its size (docs/shadows.md#layers). If faces were skipped instead of clipped, it
// would change by 44 %. The limit is 1.5 % while the bar, which is 0.16 m tall, emerges from the
// plane.
TEST(ShadowStress, LimitsChangePerMillimetreOfRisingBar) {
  for (const int segments : {3, 12}) {
    test::ShapeBuilder shape;
    shape.limb({-0.08, 0, -0.08}, {0.08, 0.01, 0.08}, 0.01, 0.012, segments);
    const ShadowMesh mesh = make_shadow_mesh(shape.build());
    const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
    const ShadowKernels kernels =
        generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
    const auto place = [&](int step) {
      return place_caster(mesh, kernels,
                          {Eigen::Vector3d(0, 0, 1e-3 * step), Eigen::Quaterniond::Identity(), 1.0},
                          PlaneFrame());
    };
    const double footprint =
        union_of_triangles(orthogonal_triangles(place(100), mesh.indices)).value().area;
    ASSERT_GT(footprint, 0.002);
    double before[3] = {0.0, 0.0, 0.0};
    for (int step = -90; step <= 400; ++step) {
      const auto vertices = place(step);
      for (std::size_t i = 0; i < 3; ++i) {
        const double area =
            union_of_triangles(layer_triangles(vertices, mesh.indices, constants, kShadowLayers[i]))
                .value()
                .area;
        // The change is relative to the layer's size, or to the footprint's size for a layer that
        // has just appeared or has almost vanished.
        const double tolerance = step < 95 ? 0.015 : 0.01;
        EXPECT_LE(std::abs(area - before[i]), tolerance * std::max({area, before[i], footprint}))
            << "layer " << i << " at " << step << " mm";
        before[i] = area;
      }
    }
    EXPECT_EQ(before[0], 0.0);
    EXPECT_GT(before[2], 4.0 * footprint);
  }
}

// However faces fold over, a layer must stay within the caster's outline, dilated by the largest
// displacement of its vertices. The distance of the kernels bounds this displacement
// (docs/shadows.md#fold-overs, 2.6 rule 5), and the thickness of the parts bounds that distance.
RC_GTEST_PROP(LayerOvershoot, StaysWithinKernelDistance, ()) {
  // The bodies are closed. A soup has faces that are seen edge-on, which have no outline but may
  // gain area in a layer.
  const ShadowMesh mesh = make_shadow_mesh(any_body());
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const Placement placement = {Eigen::Vector3d(0, 0, real(0.1, 0.15)), any_rotation(), 1.0};
  const PlaneFrame plane;
  const ShadowKernels kernels =
      generate_kernels(mesh, up_in_object(placement, plane), KernelSource::automatic);
  const auto vertices = place_caster(mesh, kernels, placement, plane);
  // Largest displacement of the vertices that follows from heights and the thickness of parts,
  // without the kernels.
  const auto distances = test::kernel_distances(mesh, kernels);
  double moved = 0.0;
  for (std::size_t i = 0; i < distances.size(); ++i) {
    RC_ASSERT(distances[i].distance <= test::max_allowed_distance(distances[i]));
    const double height = static_cast<double>(vertices[i].h);
    const double growth = layer_factor(constants, ShadowLayer::penumbra, height) - 1.0;
    moved = std::max(moved, growth * test::max_allowed_distance(distances[i]));
  }
  const auto orthogonal = union_of_triangles(orthogonal_triangles(vertices, mesh.indices));
  RC_ASSERT(orthogonal.has_value());
  std::vector<test::Ring> rings;
  for (const LayerPolygon& polygon : orthogonal->polygons) {
    rings.push_back(polygon.outer);
    rings.insert(rings.end(), polygon.holes.begin(), polygon.holes.end());
  }
  const auto layer = layer_triangles(vertices, mesh.indices, constants, ShadowLayer::penumbra);
  const auto outline = union_of_triangles(layer);
  RC_ASSERT(outline.has_value());
  if (rings.empty()) return;
  for (const LayerPolygon& polygon : outline->polygons) {
    for (const Eigen::Vector2d& p : polygon.outer) {
      RC_ASSERT(test::distance_to_rings(p, rings) <= moved + 1e-5);
    }
  }
}

struct Surface {
  explicit Surface(const ShadowMesh& of)
      : mesh(of),
        kernels(generate_kernels(of, Eigen::Vector3d::UnitZ(), KernelSource::automatic)) {}

  [[nodiscard]] std::vector<Eigen::Vector2d> image(double s) const {
    std::vector<Eigen::Vector2d> points;
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      const Eigen::Vector2d x(static_cast<double>(mesh.positions[i].x),
                              static_cast<double>(mesh.positions[i].y));
      const Eigen::Vector2d k(static_cast<double>(kernels.kernels[i].x),
                              static_cast<double>(kernels.kernels[i].y));
      points.push_back(k + s * (x - k));
    }
    return points;
  }

  ShadowMesh mesh;
  ShadowKernels kernels;
};

// Returns the same surface with edges of at most 1 / `parts` of its extent.
Surface split(const ShadowMesh& mesh, float parts) {
  float extent = 0.0F;
  const glm::vec3 first = mesh.positions.front();
  for (const glm::vec3& p : mesh.positions)
    extent = std::max({extent, std::abs(p.x - first.x), std::abs(p.y - first.y)});
  const CasterGeometry geometry = split_long_edges(mesh, extent / parts, 600'000);
  Model model;
  model.meshes.emplace_back();
  model.meshes[0].positions = geometry.positions;
  model.meshes[0].indices = geometry.indices;
  return Surface(make_shadow_mesh(model));
}

// Returns the fraction of a layer's area that lies outside the exact layer, in which each surface
// point has its own kernel. Coarse faces whose vertices have different kernels cause it, twisted or
// not (docs/shadows.md#fold-overs (3)). Valid for growing layers only: an exact shrinking layer has
// gaps where kernels change, and coarse faces close these gaps.
double overshoot_of(const Surface& coarse, const Surface& fine, double s) {
  const auto coarse_image = coarse.image(s);
  const auto fine_image = fine.image(s);
  Eigen::Vector2d low = coarse_image.front();
  Eigen::Vector2d high = low;
  for (const auto* points : {&coarse_image, &fine_image}) {
    for (const Eigen::Vector2d& p : *points) {
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
  }
  constexpr int kPixels = 200;
  const double side = 1.1 * (high - low).maxCoeff();
  const test::Mask empty(0.5 * (low + high) - Eigen::Vector2d::Constant(0.5 * side), side / kPixels,
                         kPixels);
  const auto cover = [](test::Mask& mask, const ShadowMesh& of,
                        const std::vector<Eigen::Vector2d>& points, double longest) {
    for (std::size_t i = 0; i + 2 < of.indices.size(); i += 3) {
      const std::array<Eigen::Vector2d, 3> corners = {
          points[of.indices[i]], points[of.indices[i + 1]], points[of.indices[i + 2]]};
      if ((corners[1] - corners[0]).norm() <= longest &&
          (corners[2] - corners[1]).norm() <= longest &&
          (corners[0] - corners[2]).norm() <= longest)
        mask.cover_triangle(corners);
    }
  };
  test::Mask layer = empty;
  cover(layer, coarse.mesh, coarse_image, kInfinity);
  // Fine faces that are stretched by a change of kernel are not part of the exact layer.
  test::Mask reference = empty;
  cover(reference, fine.mesh, fine_image, 4.0 * empty.pixel);
  for (const Eigen::Vector2d& p : fine_image) {
    const Eigen::Vector2d pixel = (p - empty.origin) / empty.pixel;
    const int column = static_cast<int>(pixel.x());
    const int row = static_cast<int>(pixel.y());
    for (int dy = -1; dy <= 1; ++dy)
      for (int dx = -1; dx <= 1; ++dx)
        if (column + dx >= 0 && row + dy >= 0 && column + dx < kPixels && row + dy < kPixels)
          reference.bits[reference.index(column + dx, row + dy)] = 1;
  }
  double outside = 0.0;
  double all = 0.0;
  for (std::size_t i = 0; i < layer.bits.size(); ++i) {
    all += layer.bits[i];
    outside += layer.bits[i] != 0 && reference.bits[i] == 0 ? 1.0 : 0.0;
  }
  return outside / all;
}

TEST(ShadowStress, BoundsOvershootOfTwistedFaces) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  for (const char* name : {"sphere", "cube6", "bar", "lshape", "letter_r", "torus", "tube",
                           "helicopter", "stairs", "hand"}) {
    const test::VectorMesh mesh(test::shared_dir() / "vectors" / "meshes" /
                                (std::string(name) + ".json"));
    const Surface coarse(mesh.mesh);
    const Surface fine = split(mesh.mesh, 150.0F);
    for (const double s : {1.3, 1.65}) {
      const double overshoot = overshoot_of(coarse, fine, s);
      EXPECT_LE(overshoot, std::string(name) == "hand" ? 0.10 : 0.05) << name << " at factor " << s;
    }
  }
}

// The union of a soup must be the same if computed at once or in pieces.
RC_GTEST_PROP(LayerUnion, IsSameInPiecesAndAtOnce, ()) {
  std::vector<PlanePoint> triangles;
  const double size = std::pow(10.0, real(-2.0, 0.0));
  const int faces = *rc::gen::inRange(1, 150);
  for (int i = 0; i < faces; ++i) {
    const float u = real_f(-1, 1);
    const float v = real_f(-1, 1);
    for (int corner = 0; corner < 3; ++corner)
      triangles.push_back({u + real_f(-size, size), v + real_f(-size, size)});
  }
  const auto whole = union_of_triangles(triangles, 1'000'000);
  RC_ASSERT(whole.has_value());
  for (const std::size_t edges : {std::size_t{0}, std::size_t{40}}) {
    const auto pieces = union_of_triangles(triangles, edges);
    RC_ASSERT(pieces.has_value());
    RC_ASSERT(std::abs(pieces->area - whole->area) <= 1e-6 * whole->area);
  }
}

TEST(ShadowStress, ComputesUnionOf25000UnconnectedFaces) {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> unit(-1.0F, 1.0F);
  std::vector<PlanePoint> triangles;
  test::Mask mask({-1.2, -1.2}, 2.4 / 1024.0, 1024);
  for (int i = 0; i < 25'000; ++i) {
    const float u = unit(random);
    const float v = unit(random);
    for (int corner = 0; corner < 3; ++corner)
      triangles.push_back({u + 0.2F * unit(random), v + 0.2F * unit(random)});
  }
  mask.cover(triangles);
  const auto outline = union_of_triangles(triangles);
  ASSERT_TRUE(outline);
  EXPECT_NEAR(outline->area, mask.area(), 2e-3 * mask.area());
}

// Objects of 0.1 mm and of 10 km must have the same layers up to scale if the light is scaled too.
// The body is simple, because vertices within 10 um are welded.
TEST(ShadowStress, ScalesLayersWithObjectSize) {
  const Model unit = [] {
    test::ShapeBuilder shape;
    shape.prism({{0.0, 0.0}, {1.0, 0.0}, {1.0, 0.3}, {0.3, 0.3}, {0.3, 1.0}, {0.0, 1.0}}, 0.0, 0.2);
    return shape.build();
  }();
  const Eigen::Quaterniond tilt(
      Eigen::AngleAxisd(0.4, Eigen::Vector3d(1.0, 0.3, 0.0).normalized()));
  double kernel_areas[3] = {0, 0, 0};
  double field_areas[3] = {0, 0, 0};
  for (const double size : {1.0, 1e-4, 1e-2, 1e2, 1e4}) {
    Model model = unit;
    for (glm::vec3& p : model.meshes[0].positions) p *= static_cast<float>(size);
    const ShadowMesh mesh = make_shadow_mesh(model);
    ASSERT_EQ(mesh.positions.size(), unit.meshes[0].positions.size()) << size;
    // The distance of the plane from the origin is 100 m or the object's size, whichever is larger.
    const PlaneFrame plane =
        PlaneFrame::make({0.3, -0.5, 0.8}, std::max(100.0, size) * Eigen::Vector3d(0.6, -0.3, 0.7));
    const Placement placement = {plane.q + 0.6 * size * plane.n, tilt, 1.0};
    const LayeredConstants constants = make_layered_constants(6.0 * size, 3.0, 0.0).value();
    const Eigen::Vector3d up = up_in_object(placement, plane);
    const auto vertices =
        place_caster(mesh, generate_kernels(mesh, up, KernelSource::automatic), placement, plane);
    const ShadowField field =
        power_distance_layers(vertices, mesh.indices, mesh.part,
                              part_lights(part_discs(mesh, up), placement, plane), constants);
    for (std::size_t i = 0; i < 3; ++i) {
      // Computes areas at scale 1, because unions are exact only to 1e-12 m^2.
      const auto area_at_size_1 = [size](std::vector<PlanePoint> triangles) {
        for (PlanePoint& p : triangles) {
          p.u = static_cast<float>(static_cast<double>(p.u) / size);
          p.v = static_cast<float>(static_cast<double>(p.v) / size);
        }
        return union_of_triangles(triangles).value().area;
      };
      const double by_kernels =
          area_at_size_1(layer_triangles(vertices, mesh.indices, constants, kShadowLayers[i]));
      const double by_field = area_at_size_1(field_triangles(field, kShadowLayers[i]));
      if (size == 1.0) {
        kernel_areas[i] = by_kernels;
        field_areas[i] = by_field;
        EXPECT_GT(by_kernels, 0.05);
        EXPECT_GT(by_field, 0.05);
        continue;
      }
      // Tolerance: rounding to float moves the cells of a raster.
      EXPECT_NEAR(by_kernels, kernel_areas[i], 0.01 * kernel_areas[i]) << size << " layer " << i;
      EXPECT_NEAR(by_field, field_areas[i], 0.01 * field_areas[i]) << size << " layer " << i;
    }
  }
}

TEST(ShadowStress, ComputesFieldOfMillionTriangles) {
  const ShadowMesh mesh = make_shadow_mesh(test::torus_model(500, 1000));
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const Placement placement = {Eigen::Vector3d(0, 0, 0.1), Eigen::Quaterniond::Identity(), 1.0};
  const PlaneFrame plane;
  const ShadowKernels none{plane.n, mesh.positions, {}};
  const auto discs = part_discs(mesh, plane.n);
  ASSERT_EQ(discs.size(), 1U);
  EXPECT_NEAR(static_cast<double>(discs[0].radius), 0.012, 0.0006);
  const ShadowField field =
      power_distance_layers(place_caster(mesh, none, placement, plane), mesh.indices, mesh.part,
                            part_lights(discs, placement, plane), constants);
  // Below the light, the ring of radius 0.05 and thickness 0.012 is magnified by H / (H - h) =
  // 1.125, and its rims move by a r h / (H - h).
  const double grown = 1.125;
  const double rim = 3.0 * 0.012 * 0.1 / 0.8;
  const auto ring = [&](double out) {
    const double outer = 0.062 * grown + out;
    const double inner = 0.038 * grown - out;
    return std::numbers::pi * (outer * outer - inner * inner);
  };
  EXPECT_NEAR(area_at(field, ShadowLayer::middle), ring(0.0), 0.02 * ring(0.0));
  EXPECT_NEAR(area_at(field, ShadowLayer::penumbra), ring(rim), 0.02 * ring(rim));
  EXPECT_NEAR(area_at(field, ShadowLayer::umbra), ring(-rim), 0.05 * ring(-rim));
  // Also runs the other stages that visit every face.
  const auto kernels = generate_kernels(mesh, plane.n, KernelSource::automatic);
  const auto vertices = place_caster(mesh, kernels, placement, plane);
  const double area_fraction = find_twists(vertices, mesh.indices, 0.05, 1.65).area_share;
  EXPECT_GT(area_fraction, 0.0);
  EXPECT_LT(area_fraction, 1.0);
  EXPECT_LT(layer_overshoot(mesh, kernels, 1.65), 0.02) << "twisted faces do not overshoot";
}

// The short form has 160,000 triangles.
TEST(ShadowStress, ComputesLayersOfMillionTriangles) {
  const int rings = test::nightly() ? 500 : 200;
  const Model model = test::torus_model(rings, 2 * rings);
  const ShadowMesh mesh = make_shadow_mesh(model);
  EXPECT_EQ(mesh.indices.size(), 12U * static_cast<std::size_t>(rings * rings));
  const ShadowKernels kernels =
      generate_kernels(mesh, Eigen::Vector3d(0.1, 0.0, 1.0), KernelSource::automatic);
  for (const glm::vec3& k : kernels.kernels) ASSERT_TRUE(finite(k));
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const Placement placement = {Eigen::Vector3d(0, 0, 0.1), Eigen::Quaterniond::Identity(), 1.0};
  const auto vertices = place_caster(mesh, kernels, placement, PlaneFrame());
  const auto outline =
      union_of_triangles(layer_triangles(vertices, mesh.indices, constants, ShadowLayer::penumbra));
  ASSERT_TRUE(outline);
  ASSERT_EQ(outline->polygons.size(), 1U);
  // The shadow of a ring has one large hole, and tiny holes where neighbouring kernels differ.
  double largest = 0.0;
  double all = 0.0;
  for (const auto& hole : outline->polygons[0].holes) {
    double area = 0.0;
    for (std::size_t i = 0; i < hole.size(); ++i) {
      const Eigen::Vector2d& p = hole[i];
      const Eigen::Vector2d& q = hole[(i + 1) % hole.size()];
      area += 0.5 * (p.y() * q.x() - p.x() * q.y());
    }
    largest = std::max(largest, area);
    all += area;
  }
  EXPECT_NEAR(largest, std::numbers::pi * std::pow(0.05 - 1.5 * 0.012, 2), 1.2e-3 * 0.3);
  EXPECT_LT(all - largest, 1e-3 * largest);
}

}  // namespace
}  // namespace penumbra
