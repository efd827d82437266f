// Layers and kernels over random casters, poses, planes and constants.
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>

#include "render/shadow/layer_polygons.hpp"
#include "render/shadow/layer_update.hpp"
#include "render/shadow/twist.hpp"
#include "support/shapes.hpp"

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

// A soup of faces, some of them slivers, points, repeated or unconnected.
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

RC_GTEST_PROP(LayerProperties, FloatStaysWithinItsBoundOfTheExactFactor, ()) {
  const LayeredConstants given = any_constants();
  LayeredConstants constants = given;
  constants.light_height = static_cast<double>(static_cast<float>(given.light_height));
  constants.light_ratio = static_cast<double>(static_cast<float>(given.light_ratio));
  if (!std::isinf(given.light_height))
    constants.umbra_height = constants.light_height / constants.light_ratio;
  for (const ShadowLayer layer : kShadowLayers) {
    const double high = std::min(layer_height_range(constants, layer).high, 3.0);
    // Everywhere, and next to both ends.
    const double where = real(0.0, 1.0);
    const int kind = *rc::gen::inRange(0, 3);
    const auto h = static_cast<float>(kind == 0   ? where * high
                                      : kind == 1 ? high * (1.0 - 1e-6 * where)
                                                  : high * 1e-6 * where);
    const auto H = static_cast<long double>(constants.light_height);
    const auto a = static_cast<long double>(constants.light_ratio);
    const auto exact_h = static_cast<long double>(h);
    if (static_cast<double>(h) > high) continue;  // rounded up past the end
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

RC_GTEST_PROP(LayerProperties, FactorsAreOrderedAndMonotonic, ()) {
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

RC_GTEST_PROP(LayerProperties, LimitsOfHeightLightAndRatio, ()) {
  const double h_u = real(0.1, 1.0);
  const double a = real(1.5, 8.0);
  const LayeredConstants constants = make_layered_constants(a * h_u, a, 0.0).value();
  // h -> 0: rates lambda: (1 + lambda a) / H.
  for (const ShadowLayer layer : kShadowLayers) {
    const double h = 1e-7 * h_u;
    const double rate = (layer_factor(constants, layer, h) - 1.0) / h;
    const double expected = (1.0 + lambda_of(layer) * a) / (a * h_u);
    RC_ASSERT(std::abs(rate - expected) < 1e-5 * (1.0 + std::abs(expected)) / h_u);
  }
  // h -> h_u
  RC_ASSERT(layer_factor(constants, ShadowLayer::umbra, h_u * (1.0 - 1e-9)) < 1e-7);
  RC_ASSERT(layer_factor(constants, ShadowLayer::umbra, constants.umbra_height) == 0.0);
  // h -> H: the cap, finite and positive
  for (const double h : {a * h_u, a * h_u * (1.0 + 1e-12), 2.0 * a * h_u, 1e9}) {
    const double m = layer_factor(constants, ShadowLayer::middle, h);
    RC_ASSERT(std::abs(m - 8.0) < 1e-9);
  }
  // a -> 1: h_u -> H, and the umbra no longer shrinks
  const LayeredConstants equal = make_layered_constants(h_u, 1.0, 0.0).value();
  RC_ASSERT(std::abs(layer_factor(equal, ShadowLayer::umbra, 0.7 * h_u) - 1.0) < 1e-12);
  // H -> infinity with h_u fixed: the zenith rates
  const LayeredConstants zenith = make_layered_constants(kInfinity, 0.0, h_u).value();
  const LayeredConstants high = make_layered_constants(1e7 * h_u, 0.0, h_u).value();
  for (const ShadowLayer layer : kShadowLayers) {
    const double h = real(0.0, 1.0) * h_u;
    RC_ASSERT(std::abs(layer_factor(zenith, layer, h) - layer_factor(high, layer, h)) < 1e-6);
  }
}

RC_GTEST_PROP(LayerProperties, TotalOnAnySoupOfAnySize, ()) {
  const double size = std::pow(10.0, real(-4.0, 4.0));
  const ShadowMesh mesh = make_shadow_mesh(any_soup(size));
  const PlaneFrame plane = any_plane(*rc::gen::inRange(0, 2) == 0 ? 0.1 : 100.0);
  const Placement placement = {
      plane.q + size * Eigen::Vector3d(real(-1, 1), real(-1, 1), real(-1, 1)), any_rotation(),
      std::pow(10.0, real(-1.0, 1.0))};
  const LayeredConstants constants = any_constants();
  const auto source = kKernelSourceNames[static_cast<std::size_t>(*rc::gen::inRange(0, 4))].source;
  const ShadowKernels kernels = generate_kernels(mesh, up_in_object(placement, plane), source);
  RC_ASSERT(kernels.kernels.size() == mesh.positions.size());
  for (const glm::vec3& k : kernels.kernels) RC_ASSERT(finite(k));
  const auto vertices = place_caster(mesh, kernels, placement, plane);
  for (const ShadowLayer layer : kShadowLayers) {
    const auto triangles = layer_triangles(vertices, mesh.indices, constants, layer);
    for (const PlanePoint& p : triangles) RC_ASSERT(std::isfinite(p.u) && std::isfinite(p.v));
    const auto outline = union_of_triangles(triangles);
    RC_ASSERT(outline.has_value());
    RC_ASSERT(outline->area >= -1e-12);
  }
  const TwistReport twists = find_twists(vertices, mesh.indices, 0.05, 1.65);
  RC_ASSERT(twists.faces_twisted <= twists.faces_tested);
  LayerArrays arrays;
  update_layers(CasterArrays::make(mesh, kernels), placement, plane, constants, arrays);
  for (std::size_t layer = 0; layer < 3; ++layer)
    for (std::size_t i = 0; i < arrays.h.size(); ++i)
      RC_ASSERT(std::isfinite(arrays.u[layer][i]) && std::isfinite(arrays.v[layer][i]));
}

RC_GTEST_PROP(LayerProperties, VerticesThatAreNoNumbersAreLeftOut, ()) {
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
  // And in the layer itself, should one come by another way.
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

// Sliding on the plane and turning about its normal moves the layers rigidly.
RC_GTEST_PROP(LayerProperties, EquivariantUnderSlidesAndYaw, ()) {
  const ShadowMesh mesh = make_shadow_mesh(any_soup(0.1));
  const LayeredConstants constants = any_constants();
  const PlaneFrame plane;
  const Placement before = {Eigen::Vector3d(0, 0, real(0.0, 0.3)), any_rotation(), 1.0};
  const double yaw = real(-3.0, 3.0);
  const Eigen::Vector3d slide(real(-1, 1), real(-1, 1), 0.0);
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()));
  const Placement after = {turn * before.position + slide, turn * before.rotation, 1.0};
  // The kernels stay: the up direction in the object's frame is the same.
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

// A level star-shaped footprint with its kernel in the middle: umbra inside middle inside penumbra.
RC_GTEST_PROP(LayerProperties, LayersOfAStarNest, ()) {
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
  // The union of two nested layers is the outer one.
  for (std::size_t i = 0; i + 1 < 3; ++i) {
    auto both = layer_triangles(vertices, indices, constants, kShadowLayers[i]);
    const auto outer = layer_triangles(vertices, indices, constants, kShadowLayers[i + 1]);
    both.insert(both.end(), outer.begin(), outer.end());
    const auto outline = union_of_triangles(both);
    RC_ASSERT(outline.has_value());
    RC_ASSERT(std::abs(outline->area - area[i + 1]) <= 1e-5 * area[i + 1] + 1e-10);
  }
}

// No jump in a layer's area while a caster rises through the plane and through the umbra height.
RC_GTEST_PROP(LayerProperties, AreaIsContinuousInHeight, ()) {
  test::ShapeBuilder shape;
  shape.limb({-0.08, 0, -0.05}, {0.08, 0.01, 0.05}, 0.01, 0.012, 6);
  const ShadowMesh mesh = make_shadow_mesh(shape.build());
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const ShadowKernels kernels =
      generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  const double start = real(-0.08, 0.38);
  double start_area[3] = {0, 0, 0};
  for (int side = 0; side < 2; ++side) {
    const Placement placement = {Eigen::Vector3d(0, 0, start + 0.001 * side),
                                 Eigen::Quaterniond::Identity(), 1.0};
    const auto vertices = place_caster(mesh, kernels, placement, PlaneFrame());
    for (std::size_t i = 0; i < 3; ++i) {
      const auto outline =
          union_of_triangles(layer_triangles(vertices, mesh.indices, constants, kShadowLayers[i]));
      RC_ASSERT(outline.has_value());
      if (side == 0) {
        start_area[i] = outline->area;
      } else {
        // 2 % of the caster's own footprint (0.0035 m^2) per millimetre; without clipping it
        // would be 40 %.
        RC_ASSERT(std::abs(outline->area - start_area[i]) < 0.02 * 0.0035 * (i == 2 ? 4.0 : 1.0));
      }
    }
  }
}

TEST(ShadowStress, AMillionTriangles) {
  const Model model = test::torus_model(500, 1000);
  const ShadowMesh mesh = make_shadow_mesh(model);
  EXPECT_EQ(mesh.indices.size(), 3'000'000U);
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
  // A ring's shadow is a ring: one hole, and specks where neighbouring kernels part.
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
