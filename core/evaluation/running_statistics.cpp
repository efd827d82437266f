#include "core/evaluation/running_statistics.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace penumbra {
namespace {

constexpr int kBins = (RunningStatistics::kLastOctave - RunningStatistics::kFirstOctave) *
                      RunningStatistics::kBinsPerOctave;
static_assert(std::numeric_limits<long double>::max_exponent >
                  2 * std::numeric_limits<double>::max_exponent,
              "squares of doubles have to fit");

// Returns 0 for values below the first octave, kBins + 1 for values above the final one.
std::size_t bin_of(double value) {
  if (!(value >= std::ldexp(1.0, RunningStatistics::kFirstOctave))) return 0;
  if (value >= std::ldexp(1.0, RunningStatistics::kLastOctave)) return kBins + 1;
  int exponent = 0;
  const double fraction = std::frexp(value, &exponent);  // [0.5, 1)
  const int octave = exponent - 1 - RunningStatistics::kFirstOctave;
  const int within = static_cast<int>((2.0 * fraction - 1.0) * RunningStatistics::kBinsPerOctave);
  return static_cast<std::size_t>(1 + octave * RunningStatistics::kBinsPerOctave + within);
}

double middle_of(std::size_t bin) {
  const int number = static_cast<int>(bin) - 1;
  const int octave = number / RunningStatistics::kBinsPerOctave;
  const int within = number % RunningStatistics::kBinsPerOctave;
  return std::ldexp(1.0 + (within + 0.5) / RunningStatistics::kBinsPerOctave,
                    octave + RunningStatistics::kFirstOctave);
}

}  // namespace

void RunningStatistics::add(double value) {
  if (!std::isfinite(value)) return;
  least_ = empty() ? value : std::min(least_, value);
  greatest_ = empty() ? value : std::max(greatest_, value);
  ++count_;
  sum_ += value;
  squares_ += static_cast<long double>(value) * value;
  if (bins_.empty() && values_.size() < kMaxExact) {
    values_.push_back(value);
    return;
  }
  if (bins_.empty()) {
    bins_.resize(kBins + 2);
    for (const double kept : std::exchange(values_, {})) ++bins_[bin_of(kept)];
  }
  ++bins_[bin_of(value)];
}

double RunningStatistics::mean() const {
  return empty() ? 0.0 : static_cast<double>(sum_ / static_cast<long double>(count_));
}

double RunningStatistics::value_of_rank(std::uint64_t rank) const {
  std::uint64_t below = 0;
  std::size_t bin = 0;
  while (bin + 1 < bins_.size() && below + bins_[bin] <= rank) below += bins_[bin++];
  if (bin == 0) return least_;
  if (bin + 1 == bins_.size()) return greatest_;
  return std::clamp(middle_of(bin), least_, greatest_);
}

Statistics RunningStatistics::statistics() const {
  Statistics result;
  if (empty()) return result;
  std::vector<double> sorted = values_;
  std::ranges::sort(sorted);
  // Interpolates linearly between order statistics.
  const auto quantile = [&](double share) {
    const double position = share * static_cast<double>(count_ - 1);
    const auto below = static_cast<std::uint64_t>(position);
    const std::uint64_t above = std::min<std::uint64_t>(below + 1, count_ - 1);
    const double weight = position - static_cast<double>(below);
    const auto at = [&](std::uint64_t rank) {
      return bins_.empty() ? sorted[static_cast<std::size_t>(rank)] : value_of_rank(rank);
    };
    return std::lerp(at(below), at(above), weight);
  };
  result.rmse = static_cast<double>(std::sqrt(squares_ / static_cast<long double>(count_)));
  result.median = quantile(0.5);
  result.p95 = quantile(0.95);
  result.max = greatest_;
  return result;
}

}  // namespace penumbra
