// Layers of a light of fixed size: thin parts lose their umbra at lower heights than thick parts.
#include "render/shadow/fields/fixed_light.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "render/shadow/layers/layer_polygons.hpp"

namespace penumbra {
namespace {

// A level square with half width 1 m; all its vertices share the kernel at its centre.
struct Square {
  std::vector<CasterVertex> vertices;
  std::vector<std::uint32_t> indices = {0, 1, 2, 0, 2, 3};
  std::vector<VertexDisc> discs;
  Square(float height, float radius, float part_radius) {
    for (const auto& [u, v] : {std::pair{-1.0F, -1.0F}, std::pair{1.0F, -1.0F},
                               std::pair{1.0F, 1.0F}, std::pair{-1.0F, 1.0F}}) {
      vertices.push_back({u, v, height, 0.0F, 0.0F});
    }
    discs.assign(4, {radius, part_radius});
  }
  [[nodiscard]] double area(const LayeredConstants& constants, ShadowLayer layer) const {
    return union_of_triangles(fixed_light_triangles(vertices, discs, indices, constants, layer))
        .value()
        .area;
  }
};

TEST(FixedLight, MatchesProportionalLightAtPartThickness) {
  const double infinity = std::numeric_limits<double>::infinity();
  for (const LayeredConstants& constants : {make_layered_constants(0.9, 3.0, 0.0).value(),
                                            make_layered_constants(infinity, 0.0, 0.3).value()}) {
    for (const float height : {0.0F, 0.1F, 0.25F, 0.4F}) {
      const Square square(height, 0.7F, 0.7F);
      for (const ShadowLayer layer : kShadowLayers) {
        const double s = layer_factor(constants, layer, static_cast<double>(height));
        EXPECT_NEAR(square.area(constants, layer), 4.0 * s * s, 1e-5);
      }
    }
  }
}

TEST(FixedLight, ShrinksUmbraOfThinPartsFirst) {
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  // The part is half as thick as the reference, so its light ratio is a_i = 2 a, and its umbra ends
  // at half the height.
  const double s = (0.9 - 6.0 * 0.1) / (0.9 - 0.1);
  EXPECT_NEAR(Square(0.1F, 0.5F, 1.0F).area(constants, ShadowLayer::umbra), 4.0 * s * s, 1e-5);
  EXPECT_EQ(Square(0.16F, 0.5F, 1.0F).area(constants, ShadowLayer::umbra), 0.0);
  EXPECT_GT(Square(0.16F, 1.0F, 1.0F).area(constants, ShadowLayer::umbra), 0.1);
  const double p = (0.9 + 6.0 * 0.1) / (0.9 - 0.1);
  EXPECT_NEAR(Square(0.1F, 0.5F, 1.0F).area(constants, ShadowLayer::penumbra), 4.0 * p * p, 1e-4);
}

TEST(FixedLight, ClipsFacesWhereUmbraEnds) {
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  Square square(0.0F, 1.0F, 1.0F);
  square.vertices[1].h = square.vertices[2].h = 0.6F;  // the umbra ends half-way, at 0.3 m
  // The umbra is a triangle. It extends from x = -1 (s = 1) to the clipped edge at x = 0, where it
  // has shrunk to the kernel.
  EXPECT_NEAR(square.area(constants, ShadowLayer::umbra), 1.0, 1e-5);
}

TEST(FixedLight, KeepsVerticesWithoutDiscFinite) {
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  Square square(0.1F, 0.0F, 0.0F);
  for (CasterVertex& vertex : square.vertices) {
    vertex.ku = vertex.u;
    vertex.kv = vertex.v;
  }
  EXPECT_NEAR(square.area(constants, ShadowLayer::middle), 4.0, 1e-5);
  square.vertices[0].h = std::numeric_limits<float>::quiet_NaN();
  for (const ShadowLayer layer : kShadowLayers) {
    for (const PlanePoint& p :
         fixed_light_triangles(square.vertices, square.discs, square.indices, constants, layer)) {
      EXPECT_TRUE(std::isfinite(p.u) && std::isfinite(p.v));
    }
  }
}

}  // namespace
}  // namespace penumbra
