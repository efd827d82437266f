// Medians and fractions of few values, with 95 % confidence intervals.
#pragma once

#include <optional>
#include <span>

namespace penumbra {

struct Interval {
  double low = 0.0, high = 0.0;
};

struct MedianEstimate {
  double median = 0.0;
  // Contains the median with a probability of at least 95 %; nullopt for fewer than 6 values.
  std::optional<Interval> interval;
};

// Returns the median and its distribution-free interval, or nullopt for no values. The interval is
// from the l-th smallest to the l-th largest value, with the largest l for which 2 P(B < l) <=
// 0.05, where B ~ Binomial(n, 1/2) (David and Nagaraja, Order Statistics, 3rd ed. 2003, sec. 7.1).
[[nodiscard]] std::optional<MedianEstimate> median_of(std::span<const double> values);

// The fraction `hits` / `count` with Wilson's score interval (1927, J. Am. Stat. Assoc. 22:209),
// which has a nonzero length and lies in [0, 1]. `count` > 0.
struct FractionEstimate {
  double proportion = 0.0;
  Interval interval;
};
[[nodiscard]] FractionEstimate estimate_fraction(int hits, int count);

}  // namespace penumbra
