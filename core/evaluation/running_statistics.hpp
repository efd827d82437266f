// Statistics of a stream of values of any length, in bounded memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/statistics.hpp"

namespace penumbra {

// Exact up to kMaxExact values. With more, count, mean, rmse, minimum and maximum stay exact;
// order statistics come from a histogram with kBinsPerOctave equal bins between powers of two (as
// in HdrHistogram). Their relative error is up to 1/(2 kBinsPerOctave) = 0.8 % from 2^kFirstOctave
// to 2^kLastOctave. Smaller and negative values count as the minimum, larger ones as the maximum.
class RunningStatistics {
 public:
  static constexpr std::size_t kMaxExact = 4096;
  static constexpr int kBinsPerOctave = 64;
  static constexpr int kFirstOctave = -20;
  static constexpr int kLastOctave = 44;

  // Ignores values that are not finite.
  void add(double value);
  [[nodiscard]] std::size_t count() const { return count_; }
  [[nodiscard]] bool empty() const { return count_ == 0; }
  // The following are finite, and 0 if there are no values.
  [[nodiscard]] double mean() const;
  [[nodiscard]] double least() const { return least_; }
  [[nodiscard]] double greatest() const { return greatest_; }
  // Computes the same statistics as statistics_of().
  [[nodiscard]] Statistics statistics() const;

 private:
  // Returns the value with this rank (0: minimum) from the histogram.
  [[nodiscard]] double value_of_rank(std::uint64_t rank) const;

  std::size_t count_ = 0;
  double least_ = 0.0, greatest_ = 0.0;
  // long double holds the square of any double.
  long double sum_ = 0.0L, squares_ = 0.0L;
  std::vector<double> values_;       // all values, up to kMaxExact
  std::vector<std::uint64_t> bins_;  // histogram; first and last bin: values outside the octaves
};

}  // namespace penumbra
