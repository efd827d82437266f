// Statistics of a stream of values of any length, in bounded memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/evaluation/evaluation.hpp"

namespace penumbra {

// Exact up to kMostExact values. Beyond, count, mean, rmse, least and greatest still are, and the
// order statistics between which a quantile lies come from a histogram with kBinsPerOctave bins of
// even width between powers of two (as in HdrHistogram): each within 1/(2 kBinsPerOctave), 0.8 %,
// of its value, from 2^kFirstOctave to 2^kLastOctave (a microsecond in milliseconds, to
// centuries). What is smaller, or negative, is told as the least value; what is larger as the
// greatest.
class RunningStatistics {
 public:
  static constexpr std::size_t kMostExact = 4096;
  static constexpr int kBinsPerOctave = 64;
  static constexpr int kFirstOctave = -20;
  static constexpr int kLastOctave = 44;

  // What is not finite is left out.
  void add(double value);
  [[nodiscard]] std::size_t count() const { return count_; }
  [[nodiscard]] bool empty() const { return count_ == 0; }
  // All of these are finite, and 0 for no values.
  [[nodiscard]] double mean() const;
  [[nodiscard]] double least() const { return least_; }
  [[nodiscard]] double greatest() const { return greatest_; }
  // As statistics_of().
  [[nodiscard]] Statistics statistics() const;

 private:
  // The value that has `rank` smaller ones, by the histogram.
  [[nodiscard]] double in_order(std::uint64_t rank) const;

  std::size_t count_ = 0;
  double least_ = 0.0, greatest_ = 0.0;
  // Wide enough for the squares of all doubles.
  long double sum_ = 0.0L, squares_ = 0.0L;
  std::vector<double> values_;       // while they are few
  std::vector<std::uint64_t> bins_;  // then; the first and the last hold what is beyond the octaves
};

// In the order of the values; not a number for none.
[[nodiscard]] double root_mean_square(std::span<const double> values);

}  // namespace penumbra
