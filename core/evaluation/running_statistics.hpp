// Statistics of a stream of values of any length, in bounded memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/statistics.hpp"

namespace penumbra {

// Exact up to kMostExact values. Beyond, count, mean, rmse, least and greatest stay exact, and
// order statistics come from a histogram with kBinsPerOctave bins of equal width between powers of
// two (as in HdrHistogram): each is within 1/(2 kBinsPerOctave), 0.8 %, of its value, from
// 2^kFirstOctave to 2^kLastOctave. Smaller or negative values count as the least one, larger ones
// as the greatest.
class RunningStatistics {
 public:
  static constexpr std::size_t kMostExact = 4096;
  static constexpr int kBinsPerOctave = 64;
  static constexpr int kFirstOctave = -20;
  static constexpr int kLastOctave = 44;

  // Ignores values that are not finite.
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
  // The value with this rank (0: the least), from the histogram.
  [[nodiscard]] double in_order(std::uint64_t rank) const;

  std::size_t count_ = 0;
  double least_ = 0.0, greatest_ = 0.0;
  // Wide enough for the squares of all doubles.
  long double sum_ = 0.0L, squares_ = 0.0L;
  std::vector<double> values_;       // up to kMostExact of them
  std::vector<std::uint64_t> bins_;  // beyond; the first and last hold values beyond the octaves
};

}  // namespace penumbra
