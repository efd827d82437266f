#include "render/shadow/layers/layered_penumbra.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace penumbra {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

TEST(LayeredConstants, DeriveRatioAndUmbraHeightFromEachOther) {
  const LayeredConstants from_ratio = make_layered_constants(0.9, 3.0, 0.0).value();
  EXPECT_DOUBLE_EQ(from_ratio.umbra_height, 0.3);
  const LayeredConstants from_height = make_layered_constants(0.9, 0.0, 0.3).value();
  EXPECT_DOUBLE_EQ(from_height.light_ratio, 3.0);
}

TEST(LayeredConstants, MatchWorkspaceHeightAndMagnification) {
  // For h_max = 0.30: M = 1.25 gives H = 1.50, a = 5; M = 1.5 gives 0.90, 3; M = 2 gives 0.60, 2.
  const struct {
    double magnification, light_height, ratio;
  } cases[] = {{1.25, 1.5, 5.0}, {1.5, 0.9, 3.0}, {2.0, 0.6, 2.0}};
  for (const auto& expected : cases) {
    const auto constants = layered_constants_for_workspace(0.3, expected.magnification).value();
    EXPECT_NEAR(constants.light_height, expected.light_height, 1e-12);
    EXPECT_NEAR(constants.light_ratio, expected.ratio, 1e-12);
    EXPECT_NEAR(layer_factor(constants, ShadowLayer::umbra, 0.3), 0.0, 1e-12);
    EXPECT_NEAR(layer_factor(constants, ShadowLayer::middle, 0.3), expected.magnification, 1e-12);
    EXPECT_NEAR(layer_factor(constants, ShadowLayer::penumbra, 0.3), 2.0 * expected.magnification,
                1e-12);
  }
}

TEST(LayeredConstants, RejectInvalidLights) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(make_layered_constants(0.0, 3.0, 0.0));
  EXPECT_FALSE(make_layered_constants(-1.0, 3.0, 0.0));
  EXPECT_FALSE(make_layered_constants(nan, 3.0, 0.0));
  EXPECT_FALSE(make_layered_constants(0.9, nan, 0.0));
  EXPECT_FALSE(make_layered_constants(0.9, -3.0, 0.0));
  EXPECT_FALSE(make_layered_constants(0.9, kInfinity, 0.0));
  EXPECT_FALSE(make_layered_constants(0.9, 0.0, 0.0));
  EXPECT_FALSE(make_layered_constants(0.9, 0.0, nan));
  EXPECT_FALSE(make_layered_constants(0.9, 3.0, 0.2)) << "contradicts H / a = 0.3";
  EXPECT_FALSE(make_layered_constants(kInfinity, 0.0, 0.0));
  EXPECT_FALSE(make_layered_constants(kInfinity, 3.0, 0.3));
  EXPECT_FALSE(layered_constants_for_workspace(0.3, 1.0));
  EXPECT_FALSE(layered_constants_for_workspace(nan, 1.5));
  // A float can't represent or divide by these values.
  EXPECT_FALSE(make_layered_constants(4e38, 3.0, 0.0));
  EXPECT_FALSE(make_layered_constants(1e-300, 3.0, 0.0));
  EXPECT_FALSE(make_layered_constants(0.9, 1e39, 0.0));
  EXPECT_FALSE(make_layered_constants(0.9, 1e-40, 0.0));
  EXPECT_FALSE(make_layered_constants(0.9, 0.0, 1e-40));
  EXPECT_FALSE(make_layered_constants(kInfinity, 0.0, 1e39));
  EXPECT_FALSE(make_layered_constants(1e20, 1e-20, 0.0)) << "h_u = 1e40";
  EXPECT_FALSE(layered_constants_for_workspace(1e35, 1.5));
  EXPECT_TRUE(make_layered_constants(1e6, 3.0, 0.0));
  EXPECT_TRUE(make_layered_constants(1e-6, 3.0, 0.0));
  EXPECT_TRUE(make_layered_constants(0.9, 1.0, 0.0)) << "valid: the umbra never vanishes";
  EXPECT_THAT(make_layered_constants(0.9, -3.0, 0.0).error().message,
              testing::HasSubstr("light ratio"));
}

TEST(LayerFactor, HasExactValuesAtContactUmbraHeightAndZenith) {
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const LayeredConstants zenith = make_layered_constants(kInfinity, 0.0, 0.3).value();
  for (const ShadowLayer layer : kShadowLayers) {
    EXPECT_EQ(layer_factor(constants, layer, 0.0), 1.0);
    EXPECT_EQ(layer_factor_f(constants, layer, 0.0F), 1.0F);
    EXPECT_EQ(layer_factor(zenith, layer, 0.0), 1.0);
    EXPECT_NEAR(layer_factor(zenith, layer, 0.15), 1.0 + 0.5 * lambda_of(layer), 1e-15);
    EXPECT_NEAR(layer_factor_f(zenith, layer, 0.15F),
                1.0F + 0.5F * static_cast<float>(lambda_of(layer)), 1e-7F);
  }
  EXPECT_EQ(layer_factor(constants, ShadowLayer::umbra, constants.umbra_height), 0.0);
  EXPECT_EQ(layer_factor_f(constants, ShadowLayer::umbra,
                           std::nextafter(static_cast<float>(constants.umbra_height), 1.0F)),
            0.0F);
  EXPECT_EQ(layer_factor(zenith, ShadowLayer::umbra, 0.4), 0.0);
  // At H and above, the factor equals the factor at the cap; it does not become negative.
  EXPECT_NEAR(layer_factor(constants, ShadowLayer::middle, 2.0), 8.0, 1e-12);
}

TEST(LayerHeightRange, IsLimitedByCapAndUmbraHeight) {
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  EXPECT_DOUBLE_EQ(layer_height_range(constants, ShadowLayer::umbra).high, 0.3);
  EXPECT_DOUBLE_EQ(layer_height_range(constants, ShadowLayer::middle).high, 0.9 * 7.0 / 8.0);
  // If h_u is above the cap, the cap also limits the umbra.
  const LayeredConstants small = make_layered_constants(0.9, 1.05, 0.0).value();
  EXPECT_DOUBLE_EQ(layer_height_range(small, ShadowLayer::umbra).high, 0.9 * 7.0 / 8.0);
  const LayeredConstants grows = make_layered_constants(0.9, 0.5, 0.0).value();
  EXPECT_DOUBLE_EQ(layer_height_range(grows, ShadowLayer::umbra).high, 0.9 * 7.0 / 8.0);
  EXPECT_GT(layer_factor(grows, ShadowLayer::umbra, 0.5), 1.0);
}

TEST(ClipToHeights, ClipsAtBothEndsAndKeepsInterior) {
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const std::vector<CasterVertex> vertices = {{0.0F, 0.0F, -0.1F, 0.0F, 0.0F},
                                              {1.0F, 0.0F, 0.5F, 0.5F, 0.0F},
                                              {0.0F, 1.0F, 0.1F, 0.0F, 0.5F},
                                              {1.0F, 1.0F, 0.2F, 0.5F, 0.5F}};
  const std::vector<std::uint32_t> indices = {0, 1, 2, 2, 3, 2};
  const HeightRange range = layer_height_range(constants, ShadowLayer::umbra);
  const auto triangles = clip_to_heights(vertices, indices, range);
  ASSERT_EQ(triangles.size() % 3, 0U);
  int on_floor = 0;
  int vanished = 0;
  for (const CasterVertex& vertex : triangles) {
    EXPECT_GE(vertex.h, 0.0F);
    // Position and kernel are interpolated with the same weight: here k = (u / 2, v / 2)
    // everywhere.
    EXPECT_NEAR(vertex.ku, 0.5F * vertex.u, 1e-6F);
    EXPECT_NEAR(vertex.kv, 0.5F * vertex.v, 1e-6F);
    const float s = layer_factor_f(constants, ShadowLayer::umbra, vertex.h);
    if (vertex.h == 0.0F) {
      ++on_floor;
      EXPECT_EQ(s, 1.0F);
    }
    if (s == 0.0F) {
      ++vanished;
      EXPECT_NEAR(vertex.h, 0.3F, 1e-6F);
      const PlanePoint point = project_to_layer(vertex, constants, ShadowLayer::umbra);
      EXPECT_EQ(point.u, vertex.ku);
      EXPECT_EQ(point.v, vertex.kv);
    }
  }
  EXPECT_GT(on_floor, 0);
  EXPECT_GT(vanished, 0);
}

TEST(ClipToHeights, DropsFacesWithoutShadow) {
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const std::vector<CasterVertex> vertices = {{0.0F, 0.0F, 0.4F, 0.0F, 0.0F},
                                              {1.0F, 0.0F, 0.5F, 0.0F, 0.0F},
                                              {0.0F, 1.0F, 0.6F, 0.0F, 0.0F},
                                              {nan, 0.0F, 0.1F, 0.0F, 0.0F},
                                              {0.0F, 0.0F, -0.1F, 0.0F, 0.0F}};
  const HeightRange umbra = layer_height_range(constants, ShadowLayer::umbra);
  const HeightRange middle = layer_height_range(constants, ShadowLayer::middle);
  const std::vector<std::uint32_t> high = {0, 1, 2};
  EXPECT_TRUE(clip_to_heights(vertices, high, umbra).empty());
  EXPECT_EQ(clip_to_heights(vertices, high, middle).size(), 3U);
  const std::vector<std::uint32_t> not_finite = {0, 1, 3};
  EXPECT_TRUE(clip_to_heights(vertices, not_finite, middle).empty());
  const std::vector<std::uint32_t> below = {4, 4, 4};
  EXPECT_TRUE(clip_to_heights(vertices, below, middle).empty());
  const std::vector<std::uint32_t> out_of_range = {0, 1, 77};
  EXPECT_TRUE(clip_to_heights(vertices, out_of_range, middle).empty());
}

TEST(ProjectToLayer, IsExactAtContact) {
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const CasterVertex vertex = {0.123456F, -0.98765F, 0.0F, 0.1F, -0.3F};
  for (const ShadowLayer layer : {ShadowLayer::middle, ShadowLayer::penumbra}) {
    const PlanePoint point = project_to_layer(vertex, constants, layer);
    EXPECT_EQ(point.u, vertex.u);
    EXPECT_EQ(point.v, vertex.v);
  }
}

}  // namespace
}  // namespace penumbra
