// Generated kernels and fields, compared with ray-cast shadows of an area light.
#include <gtest/gtest.h>

#include "support/kernel_quality.hpp"

namespace penumbra {
namespace {

TEST(KernelQuality, ReachesRequiredIouWithAutomaticKernels) {
  const test::QualityCases all;
  if (all.cases().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  double sum[2] = {0.0, 0.0};
  for (const test::QualityCase& quality : all.cases()) {
    std::size_t layer_index = 0;
    for (const auto& [layer, key] : test::kJudgedLayers) {
      const double iou = quality.kernel_iou(KernelSource::automatic, layer, key);
      EXPECT_GE(iou, quality.number("required_iou", key)) << quality.name() << " " << key;
      sum[layer_index++] += iou / static_cast<double>(all.cases().size());
    }
  }
  EXPECT_GE(sum[0], 0.89);
  EXPECT_GE(sum[1], 0.96);
}

TEST(KernelQuality, ComesWithin002OfMoonshotIouWithFields) {
  const test::QualityCases all;
  if (all.cases().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  double sum[2] = {0.0, 0.0};
  for (const test::QualityCase& quality : all.cases()) {
    std::size_t layer_index = 0;
    for (const auto& [layer, key] : test::kJudgedLayers) {
      const double iou = quality.field_iou(layer, key);
      EXPECT_GE(iou, quality.number("moonshot_iou", key) - 0.02) << quality.name() << " " << key;
      sum[layer_index++] += iou / static_cast<double>(all.cases().size());
    }
  }
  EXPECT_GE(sum[0], 0.97);
  EXPECT_GE(sum[1], 0.98);
}

}  // namespace
}  // namespace penumbra
