// Reduced meshes (proxies) that cast shadows in place of full meshes: when a proxy is used, and
// what it may change. Objects themselves are never drawn from a proxy.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "render/shadow/casters/caster.hpp"
#include "render/shadow/casters/shadow_proxy.hpp"
#include "render/shadow/fields/fixed_light.hpp"
#include "support/paths.hpp"
#include "support/shadow_cases.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::RenderedImage;
using test::SceneBuilder;
using test::Studio;

const LayeredConstants kLight = make_layered_constants(0.9, 3.0, 0.0).value();  // h_u = 0.3 m

ShadowMesh bundled(const char* name) {
  const Result<Model> model = load_model(test::source_dir() / "scenes/models" / name);
  EXPECT_TRUE(model) << name;
  return make_shadow_mesh(model.value());
}

// Returns the intersection over union of a layer's two shadows, on a raster four times finer than
// the raster with which the program decides whether to use the proxy.
double agreement(const ShadowMesh& full, const ShadowProxy& proxy, double height,
                 ShadowLayer layer) {
  const PlaneFrame plane;
  const ShadowKernels kernels = generate_kernels(full, plane.n, KernelSource::automatic);
  double bottom = 1e9, top = -1e9;
  for (const glm::vec3& p : full.positions) {
    bottom = std::min(bottom, static_cast<double>(p.z));
    top = std::max(top, static_cast<double>(p.z));
  }
  const double lift = std::max(-bottom, height - 0.5 * (bottom + top));
  const Placement placed{{0.0, 0.0, lift}, Eigen::Quaterniond::Identity(), 1.0};
  const auto a =
      layer_triangles(place_caster(full, kernels, placed, plane), full.indices, kLight, layer);
  const auto b =
      layer_triangles(place_caster(proxy.mesh, carried_kernels(proxy, kernels), placed, plane),
                      proxy.mesh.indices, kLight, layer);
  Eigen::Vector2d low(1e9, 1e9), high(-1e9, -1e9);
  for (const auto& points : {a, b}) {
    for (const PlanePoint& p : points) {
      const Eigen::Vector2d point(static_cast<double>(p.u), static_cast<double>(p.v));
      low = low.cwiseMin(point);
      high = high.cwiseMax(point);
    }
  }
  constexpr int kCells = 1024;
  const double cell = (high - low).maxCoeff() / kCells;
  test::Mask first(low, cell, kCells), second(low, cell, kCells);
  first.cover(a);
  second.cover(b);
  return test::iou(first.bits, second.bits);
}

TEST(ShadowProxy, MatchesAgreementOfFinerRaster) {
  for (const char* name : {"hand.glb", "tree.glb", "helicopter.glb", "spiral_staircase.glb"}) {
    SCOPED_TRACE(name);
    const ShadowMesh full = bundled(name);
    const auto proxy = simplified_caster(full);
    if (full.indices.size() / 3 <= kMinProxyFaces) {
      EXPECT_FALSE(proxy);
      continue;
    }
    ASSERT_TRUE(proxy);
    const double face_fraction =
        static_cast<double>(proxy->mesh.indices.size()) / static_cast<double>(full.indices.size());
    EXPECT_LE(face_fraction, 0.75);
    const ShadowKernels kernels =
        generate_kernels(full, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
    const ProxyAgreement found =
        compare_with_proxy(full, kernels, {}, *proxy, {kLight, LightMode::proportional, 1.0}, true);
    for (std::size_t at = 0; at < kProxyHeights.size(); ++at) {
      for (std::size_t i = 0; i < kShadowLayers.size(); ++i) {
        const double finer =
            agreement(full, *proxy, kProxyHeights[at] * kLight.umbra_height, kShadowLayers[i]);
        EXPECT_NEAR(found.iou[at][i], finer, 0.01) << "at " << kProxyHeights[at] << " h_u, layer "
                                                   << i << ", fraction of faces " << face_fraction;
      }
    }
    // A comparison that stops early reaches the same decision.
    EXPECT_EQ(
        compare_with_proxy(full, kernels, {}, *proxy, {kLight, LightMode::proportional, 1.0}, false)
            .is_sufficient(),
        found.is_sufficient());
  }
}

TEST(ShadowProxy, AgreesWithItselfButNotWithFilledHole) {
  const ShadowMesh ring = make_shadow_mesh(test::torus_model(20, 60));
  const ShadowKernels kernels =
      generate_kernels(ring, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  const auto discs = part_discs(ring, Eigen::Vector3d::UnitZ());
  ShadowProxy same{ring, {}};
  for (std::uint32_t i = 0; i < ring.positions.size(); ++i) same.source_of.push_back(i);
  for (const LightMode mode : {LightMode::proportional, LightMode::fixed}) {
    const ProxyAgreement found =
        compare_with_proxy(ring, kernels, discs, same, {kLight, mode, 1.0}, true);
    EXPECT_EQ(found.min_iou(), 1.0) << name_of(kLightModeNames, mode);
  }
  // The proxy fills the hole of the ring.
  ShadowProxy filled = same;
  const auto centre = static_cast<std::uint32_t>(filled.mesh.positions.size());
  filled.mesh.positions.emplace_back(0.0F, 0.0F, 0.0F);
  filled.mesh.part.push_back(0);
  filled.source_of.push_back(0);
  for (std::uint32_t i = 0; i < 60; ++i) {
    filled.mesh.indices.insert(filled.mesh.indices.end(), {centre, i, (i + 1) % 60});
  }
  EXPECT_FALSE(
      compare_with_proxy(ring, kernels, discs, filled, {kLight, LightMode::proportional, 1.0}, true)
          .is_sufficient());
}

TEST(ShadowProxy, CarriesKernelsFromNearestVertex) {
  const ShadowMesh full = make_shadow_mesh(test::torus_model(20, 60));
  const Model coarse = test::torus_model(10, 30);
  const ShadowProxy proxy = proxy_from_model(full, coarse);
  ASSERT_EQ(proxy.source_of.size(), proxy.mesh.positions.size());
  for (std::size_t i = 0; i < proxy.source_of.size(); ++i) {
    float nearest = 1e9F;
    for (const glm::vec3& p : full.positions) {
      nearest = std::min(nearest, glm::distance(p, proxy.mesh.positions[i]));
    }
    EXPECT_EQ(glm::distance(full.positions[proxy.source_of[i]], proxy.mesh.positions[i]), nearest);
  }
}

TEST(ShadowProxy, NeverReducesMeshOfFewFaces) {
  EXPECT_FALSE(simplified_caster(make_shadow_mesh(test::torus_model(10, 30))));
  EXPECT_FALSE(simplified_caster(ShadowMesh{}));
}

// Draws the scene with the proxy enabled and disabled.
class DrawnProxy : public testing::Test {
 protected:
  static constexpr int kSide = 400;
  // A smooth ball with a proxy that is accepted.
  static SceneBuilder ball(const Placement& placement) {
    SceneBuilder builder;
    builder.add(sphere(48, 96), placement);
    builder.scene().shadows[0].layered = kLight;
    builder.scene().objects[0].proxy_model = sphere(36, 72);
    return builder;
  }
  static std::shared_ptr<const Model> sphere(int rings, int sectors) {
    test::ShapeBuilder shape;
    shape.sphere(0.05, rings, sectors);
    return test::finished(shape.build(), glm::vec4(1.0F));
  }
  static RenderedImage draw(Studio& studio, bool proxies, bool skip = true) {
    PlanOptions options;
    options.proxies = proxies;
    options.skip = skip;
    const PoseEstimate pose = test::tracked(test::look_at({0.0, 0.0, 0.8}, {0.0, 0.0, 0.0}));
    return studio.draw_shadows(test::plain_frame(kSide, kSide, 255), studio.plan(pose, options));
  }
  static CameraModel camera() { return test::camera_of(kSide, kSide, 800.0); }
};

TEST_F(DrawnProxy, SavesFacesAndChangesFewPixels) {
  // The ball is tilted, so that its outline differs from the rings of its mesh.
  Studio studio(ball(test::at(0.0, 0.0, 0.1, {1, 0.3, 0}, 0.7)).build(), camera());
  const RenderedImage full = draw(studio, false);
  EXPECT_EQ(studio.stats()[Counter::proxy_shadows], 0);
  EXPECT_EQ(studio.stats()[Counter::proxy_checks], 0);
  EXPECT_EQ(studio.stats()[Counter::proxy_faces_saved], 0);
  const RenderedImage reduced = draw(studio, true);
  EXPECT_EQ(studio.stats()[Counter::proxy_shadows], 1);
  EXPECT_EQ(studio.stats()[Counter::proxy_checks], 1);
  EXPECT_GT(studio.stats()[Counter::proxy_faces_saved], 3 * 2000);
  std::size_t dark = 0, different = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      dark += full.red(x, y) < 255 ? 1U : 0U;
      different += full.red(x, y) != reduced.red(x, y) ? 1U : 0U;
    }
  }
  EXPECT_GT(dark, 5000U);
  // Each of the three layers agrees to at least 0.98.
  EXPECT_LT(static_cast<double>(different), 0.06 * static_cast<double>(dark));
  EXPECT_GT(different, 0U) << "no reduced mesh was drawn";
  // The proxy is compared once, because the result depends only on the tilt.
  EXPECT_EQ(draw(studio, true), reduced);
  EXPECT_EQ(studio.stats()[Counter::proxy_checks], 0);
  EXPECT_EQ(studio.stats()[Counter::proxy_shadows], 1);
  EXPECT_EQ(studio.stats()[Counter::reprojections], 1);
  EXPECT_EQ(draw(studio, true, false), reduced) << "skipping changes nothing";
}

TEST_F(DrawnProxy, CastsOnlyForObjectsOfConstantTiltAndScale) {
  const auto checks = [&](const std::vector<Placement>& keys, double spin) {
    SceneBuilder builder = ball(test::at(0.0, 0.0, 0.1));
    Animation& animation = builder.scene().objects[0].animation;
    animation.loop = false;
    animation.spin_turns_per_s = spin;
    for (const Placement& key : keys) {
      animation.keyframes.push_back({static_cast<double>(animation.keyframes.size()), key});
    }
    Studio studio(builder.build(), camera());
    draw(studio, true);
    return studio.stats()[Counter::proxy_checks];
  };
  const Eigen::Vector3d y(0, 1, 0);
  const Eigen::Vector3d z(0, 0, 1);
  EXPECT_EQ(checks({}, 0.0), 1);
  EXPECT_EQ(checks({test::at(0, 0, 0), test::at(0.05, 0, 0.1, z, 1.0)}, 0.7), 1)
      << "lifted, slid and rotated about the vertical";
  EXPECT_EQ(checks({test::at(0, 0, 0), test::at(0, 0, 0, y, 0.5)}, 0.0), 0) << "tilted";
  EXPECT_EQ(checks({test::at(0, 0, 0, y, 0.5)}, 0.0), 1) << "constant tilt";
  EXPECT_EQ(checks({test::at(0, 0, 0, y, 0.5)}, 0.7), 0) << "wobbling";
  EXPECT_EQ(checks({test::at(0, 0, 0), test::at(0, 0, 0, z, 0.0, 1.1)}, 0.0), 0) << "scaled";
}

TEST_F(DrawnProxy, IsRejectedWhenItsLayersDiffer) {
  SceneBuilder builder = ball(test::at(0.0, 0.0, 0.1));
  builder.scene().objects[0].proxy_model.reset();
  Studio none(builder.build(), camera());
  const RenderedImage image = draw(none, true);
  EXPECT_EQ(none.stats()[Counter::proxy_checks], 0);
  builder.scene().objects[0].proxy_model = test::finished(test::box_model(0.1), glm::vec4(1.0F));
  Studio wrong(builder.build(), camera());
  EXPECT_EQ(draw(wrong, true), image);
  EXPECT_EQ(wrong.stats()[Counter::proxy_checks], 1);
  EXPECT_EQ(wrong.stats()[Counter::proxy_shadows], 0);
}

}  // namespace
}  // namespace penumbra
