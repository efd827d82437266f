// Medians and shares with distribution-free 95 % confidence intervals, for few values. Pure.
#pragma once

#include <optional>
#include <span>

namespace penumbra {

struct Interval {
  double low = 0.0, high = 0.0;
};

struct MedianEstimate {
  double median = 0.0;
  // At least 95 %; absent below 6 values, which are too few for it.
  std::optional<Interval> interval;
};

// The median and its interval from the l-th smallest to the l-th largest value, l the greatest for
// which 2 P(B < l) <= 0.05 with B binomial of n and 1/2 (David and Nagaraja, Order Statistics,
// 3rd ed. 2003, section 7.1). Nothing for no values.
[[nodiscard]] std::optional<MedianEstimate> median_of(std::span<const double> values);

// The share `hits` / `count` with the score interval of Wilson 1927 (J. Am. Stat. Assoc. 22:209),
// which is never empty and stays in [0, 1]. `count` > 0.
struct ShareEstimate {
  double share = 0.0;
  Interval interval;
};
[[nodiscard]] ShareEstimate share_of(int hits, int count);

}  // namespace penumbra
