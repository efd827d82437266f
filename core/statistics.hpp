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

// Returns NaN if there are no values.
[[nodiscard]] inline double root_mean_square(std::span<const double> values) {
  double squares = 0.0;
  for (const double value : values) squares += value * value;
  return std::sqrt(squares / static_cast<double>(values.size()));
}

// Returns the sorted values' element floor(share * size), or 0 for no values; 0 <= share < 1.
[[nodiscard]] inline double order_statistic(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size()));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}
// For an even count: the upper one of the two middle values.
[[nodiscard]] inline double upper_median(std::vector<double> values) {
  return order_statistic(std::move(values), 0.5);
}

}  // namespace penumbra
