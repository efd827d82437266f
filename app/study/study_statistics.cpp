#include "app/study/study_statistics.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "core/assert.hpp"

namespace penumbra {
namespace {

constexpr double kSignificanceLevel = 0.05;     // 1 - confidence level
constexpr double kNormalQuantile = 1.95996398;  // two-sided, normal distribution at this level

// Returns l, so that the l-th smallest and the l-th largest value bound the median; 0 if too few.
std::size_t bound_of_median(std::size_t count) {
  const auto n = static_cast<double>(count);
  double below = 0.0;  // P(B < l)
  std::size_t l = 0;
  while (l < count) {
    // Computes P(B = l) with logarithms, because 2^-n underflows for thousands of values.
    const auto k = static_cast<double>(l);
    below += std::exp(std::lgamma(n + 1.0) - std::lgamma(k + 1.0) - std::lgamma(n - k + 1.0) -
                      n * std::numbers::ln2);
    if (2.0 * below > kSignificanceLevel) break;
    ++l;
  }
  return l;
}

}  // namespace

std::optional<MedianEstimate> median_of(std::span<const double> values) {
  if (values.empty()) return std::nullopt;
  std::vector<double> sorted(values.begin(), values.end());
  std::ranges::sort(sorted);
  const std::size_t n = sorted.size();
  MedianEstimate estimate;
  estimate.median =
      n % 2 == 1 ? sorted[n / 2] : sorted[n / 2 - 1] + 0.5 * (sorted[n / 2] - sorted[n / 2 - 1]);
  if (const std::size_t l = bound_of_median(n); l > 0) {
    estimate.interval = {sorted[l - 1], sorted[n - l]};
  }
  return estimate;
}

FractionEstimate estimate_fraction(int hits, int count) {
  PENUMBRA_ASSERT(count > 0 && hits >= 0 && hits <= count);
  const double n = count;
  const double proportion = hits / n;
  const double z2 = kNormalQuantile * kNormalQuantile;
  const double middle = (proportion + z2 / (2.0 * n)) / (1.0 + z2 / n);
  const double half = kNormalQuantile / (1.0 + z2 / n) *
                      std::sqrt(proportion * (1.0 - proportion) / n + z2 / (4.0 * n * n));
  return {proportion,
          {hits == 0 ? 0.0 : std::max(0.0, middle - half),
           hits == count ? 1.0 : std::min(1.0, middle + half)}};
}

}  // namespace penumbra
