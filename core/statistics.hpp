// Statistics of values in memory.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

namespace penumbra {

// In the unit of the values.
struct Statistics {
  double rmse = 0.0;
  double median = 0.0;
  double p95 = 0.0;
  double max = 0.0;
};

// NaN for no values.
[[nodiscard]] inline double root_mean_square(std::span<const double> values) {
  double squares = 0.0;
  for (const double value : values) squares += value * value;
  return std::sqrt(squares / static_cast<double>(values.size()));
}

// The value at index floor(share * size) of the sorted values, 0 <= share < 1. Zero for no values.
[[nodiscard]] inline double order_statistic(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size()));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}
// The upper one of two.
[[nodiscard]] inline double upper_median(std::vector<double> values) {
  return order_statistic(std::move(values), 0.5);
}

}  // namespace penumbra
