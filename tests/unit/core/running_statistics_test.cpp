#include "core/evaluation/running_statistics.hpp"

#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <rapidcheck/gtest.h>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "support/random_session.hpp"

namespace penumbra {
namespace {

using test::RandomNumbers;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kHuge = std::numeric_limits<double>::max();
constexpr double kBinError = 0.5 / RunningStatistics::kBinsPerOctave;

RunningStatistics running(const std::vector<double>& values) {
  RunningStatistics statistics;
  for (const double value : values) statistics.add(value);
  return statistics;
}

// The quantile if all values are lowered by the error of their bin, and if all are raised.
struct Bounds {
  double low = 0.0, high = 0.0;
};
Bounds bounds_of(std::vector<double> values, double fraction) {
  std::ranges::sort(values);
  const double minimum = values.front();
  const double maximum = values.back();
  const double first = std::ldexp(1.0, RunningStatistics::kFirstOctave);
  const double last = std::ldexp(1.0, RunningStatistics::kLastOctave);
  const auto moved = [&](double value, double by) {
    if (value < first) return minimum;
    if (value >= last) return maximum;
    return std::clamp(value * (1.0 + by), minimum, maximum);
  };
  const double position = fraction * static_cast<double>(values.size() - 1);
  const auto below = static_cast<std::size_t>(position);
  const std::size_t above = std::min(below + 1, values.size() - 1);
  const double weight = position - static_cast<double>(below);
  const auto at = [&](double by) {
    return std::lerp(moved(values[below], by), moved(values[above], by), weight);
  };
  return {at(-kBinError), at(kBinError)};
}

void expect_near_exact(const std::vector<double>& values) {
  const Statistics found = running(values).statistics();
  const double slack = 1e-12;
  const auto within = [&](double value, double fraction) {
    const Bounds bounds = bounds_of(values, fraction);
    RC_ASSERT(value >= bounds.low - slack * std::abs(bounds.low));
    RC_ASSERT(value <= bounds.high + slack * std::abs(bounds.high));
  };
  within(found.median, 0.5);
  within(found.p95, 0.95);
  RC_ASSERT(found.max == *std::ranges::max_element(values));
}

TEST(RunningStatistics, IsExactForFewValues) {
  RandomNumbers draw(3);
  std::vector<double> values;
  for (std::size_t i = 0; i < RunningStatistics::kMaxExact; ++i) {
    values.push_back(draw.log_between(1e-9, 1e9) * (i % 7 == 0 ? -1.0 : 1.0));
    if (i % 500 > 3 && i + 1 != RunningStatistics::kMaxExact) continue;
    const RunningStatistics statistics = running(values);
    const Statistics found = statistics.statistics();
    const Statistics exact = statistics_of(values);
    EXPECT_EQ(statistics.count(), values.size());
    EXPECT_NEAR(found.median, exact.median, 1e-12 * exact.rmse);
    EXPECT_NEAR(found.p95, exact.p95, 1e-12 * exact.rmse);
    EXPECT_EQ(found.max, exact.max);
    EXPECT_NEAR(found.rmse, exact.rmse, 1e-12 * exact.rmse);
    const auto mean = static_cast<double>(std::accumulate(values.begin(), values.end(), 0.0L) /
                                          static_cast<long double>(values.size()));
    EXPECT_NEAR(statistics.mean(), mean, 1e-9 * exact.rmse);
  }
}

TEST(RunningStatistics, IsZeroWithoutValues) {
  const RunningStatistics nothing;
  EXPECT_TRUE(nothing.empty());
  const Statistics s = nothing.statistics();
  for (const double value :
       {s.rmse, s.median, s.p95, s.max, nothing.mean(), nothing.least(), nothing.greatest()}) {
    EXPECT_EQ(value, 0.0);
  }
}

TEST(RunningStatistics, IgnoresNonFiniteValues) {
  RunningStatistics statistics;
  for (std::size_t i = 0; i < 2 * RunningStatistics::kMaxExact; ++i) {
    for (const double value : {std::nan(""), kInfinity, -kInfinity, 2.0}) statistics.add(value);
  }
  EXPECT_EQ(statistics.count(), 2 * RunningStatistics::kMaxExact);
  const Statistics s = statistics.statistics();
  for (const double value : {s.rmse, s.median, s.p95, s.max, statistics.mean()}) {
    EXPECT_EQ(value, 2.0);
  }
}

// All counts exceed the limit of exact storage, by 1 or more. The values are zeros, powers of two,
// random numbers of both signs, or one repeated number.
RC_GTEST_PROP(RunningStatistics, StaysWithinBinErrorForManyValues, ()) {
  RandomNumbers draw(*rc::gen::arbitrary<std::uint64_t>());
  const std::size_t more[] = {1, 2, 100, 3 * RunningStatistics::kMaxExact};
  const std::size_t count =
      RunningStatistics::kMaxExact + more[static_cast<std::size_t>(draw.below(4))];
  const double low = draw.log_between(1e-7, 1e12);
  const double high = low * draw.log_between(1.0, 1e9);
  const auto kinds = 1 + draw.below(5);
  std::vector<double> values;
  for (std::size_t i = 0; i < count; ++i) {
    const auto kind = draw.below(kinds);
    values.push_back(kind == 1   ? 0.0
                     : kind == 2 ? std::ldexp(1.0, static_cast<int>(draw.below(80)) - 30)
                     : kind == 3 ? -draw.log_between(low, high)
                     : kind == 4 ? low
                                 : draw.log_between(low, high));
  }
  expect_near_exact(values);
  const RunningStatistics statistics = running(values);
  const Statistics exact = statistics_of(values);
  RC_ASSERT(std::abs(statistics.statistics().rmse - exact.rmse) <= 1e-9 * exact.rmse);
  const auto mean = static_cast<double>(std::accumulate(values.begin(), values.end(), 0.0L) /
                                        static_cast<long double>(count));
  RC_ASSERT(std::abs(statistics.mean() - mean) <= 1e-12 * exact.rmse);
}

RC_GTEST_PROP(RunningStatistics, StaysFiniteAndOrderedForAnyInput, ()) {
  RandomNumbers draw(*rc::gen::arbitrary<std::uint64_t>());
  const bool many = draw() < 0.5;
  RunningStatistics statistics;
  for (std::size_t i = 0; i < (many ? 2 * RunningStatistics::kMaxExact : 20); ++i) {
    const double kind = draw();
    const double sign = draw() < 0.5 ? -1.0 : 1.0;
    statistics.add(sign * (kind < 0.2   ? kHuge
                           : kind < 0.3 ? 0.0
                           : kind < 0.4 ? std::numeric_limits<double>::denorm_min()
                           : kind < 0.5 ? kInfinity
                           : kind < 0.6 ? std::nan("")
                                        : std::pow(10.0, draw.between(-308.0, 308.0))));
  }
  const Statistics s = statistics.statistics();
  for (const double value : {s.rmse, s.median, s.p95, s.max, statistics.mean()}) {
    RC_ASSERT(std::isfinite(value));
  }
  RC_ASSERT(statistics.least() <= s.median && s.median <= s.p95 && s.p95 <= s.max);
  RC_ASSERT(s.rmse >= 0.0);
}

}  // namespace
}  // namespace penumbra
