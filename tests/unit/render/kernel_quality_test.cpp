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
    std::size_t which = 0;
    for (const auto& [layer, key] : test::kJudgedLayers) {
      const double reached = quality.kernel_iou(KernelSource::automatic, layer, key);
      EXPECT_GE(reached, quality.number("required_iou", key)) << quality.name() << " " << key;
      sum[which++] += reached / static_cast<double>(all.cases().size());
    }
  }
  EXPECT_GE(sum[0], 0.89);
  EXPECT_GE(sum[1], 0.96);
}

TEST(KernelQuality, ReachesRequiredIouWithFields) {
  const test::QualityCases all;
  if (all.cases().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  double sum[2] = {0.0, 0.0};
  for (const test::QualityCase& quality : all.cases()) {
    std::size_t which = 0;
    for (const auto& [layer, key] : test::kJudgedLayers) {
      const double reached = quality.field_iou(layer, key);
      EXPECT_GE(reached, quality.number("moonshot_iou", key) - 0.02)
          << quality.name() << " " << key;
      sum[which++] += reached / static_cast<double>(all.cases().size());
    }
  }
  EXPECT_GE(sum[0], 0.97);
  EXPECT_GE(sum[1], 0.98);
}

}  // namespace
}  // namespace penumbra
