#include "app/capture/clocks.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <utility>
#include <vector>

namespace penumbra {
namespace {

// Returns the readings in turn.
std::function<ClockReading()> readings(std::vector<ClockReading> list, int* count = nullptr) {
  return [list = std::move(list), at = std::size_t{0}, count]() mutable {
    if (count != nullptr) ++*count;
    return list.at(at++);
  };
}

TEST(UtcAt, AddsDifferenceOfClocks) {
  int count = 0;
  const std::int64_t utc = utc_at(900'000, readings({{1'000'000, 1'000'200, 5'000'000}}, &count));
  EXPECT_EQ(utc, 5'000'000 + 900'000 - 1'000'100);
  EXPECT_EQ(count, 1) << "a short interval needs no second reading";
}

// The thread was suspended in the first and the last reading.
TEST(UtcAt, UsesReadingWithShortestInterval) {
  EXPECT_EQ(utc_at(0, readings({{0, 8'000'000, 100},
                                {9'000'000, 9'003'000, 9'101'500},
                                {9'100'000, 9'103'001, 55},
                                {9'200'000, 9'900'000, 55}})),
            100'000);
}

// Each frame is on the clock as set when it arrives; the step is not spread over frames.
TEST(UtcAt, FollowsStepOfUtcAtOnce) {
  EXPECT_EQ(utc_at(1'000, readings({{2'000, 2'000, 7'002'000}})), 7'001'000);
  EXPECT_EQ(utc_at(3'000, readings({{4'000, 4'000, 1'004'000}})), 1'003'000);
  EXPECT_EQ(utc_at(5'000, readings({{6'000, 6'000, -1'000'000}})), -1'001'000);
}

TEST(UtcAt, AgreesWithSystemClock) {
  const auto system_ns = [] {
    return std::chrono::system_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
  };
  const std::int64_t before = system_ns();
  const std::int64_t utc = utc_at(monotonic_ns());
  const std::int64_t after = system_ns();
  EXPECT_GE(utc, before - 1'000'000);
  EXPECT_LE(utc, after + 1'000'000);
}

}  // namespace
}  // namespace penumbra
