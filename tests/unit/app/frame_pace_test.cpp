#include "app/capture/frame_clock.hpp"

#include <gtest/gtest.h>

namespace penumbra {
namespace {

constexpr std::int64_t kMillisecond = 1'000'000;

TEST(FramePace, DeclaresStaleAfterQuarterSecondAndStallAfterOne) {
  FramePace pace(33 * kMillisecond);
  for (int i = 0; i < 10; ++i) pace.observe(i * 33 * kMillisecond);
  EXPECT_EQ(pace.expected_ns(), 33 * kMillisecond);
  EXPECT_EQ(pace.stall_timeout_ns(), 1000 * kMillisecond);
  EXPECT_EQ(pace.stale_after_ns(), 250 * kMillisecond);
}

// The rate that the camera granted may be higher than the rate at which it delivers.
TEST(FramePace, NeverDeclaresStallBetweenFramesOfSlowCamera) {
  for (const std::int64_t granted_ns : {std::int64_t{0}, 33 * kMillisecond, 1000 * kMillisecond}) {
    FramePace pace(granted_ns);
    pace.observe(0);
    for (int i = 1; i < 20; ++i) {
      EXPECT_GT(pace.stall_timeout_ns(), 1000 * kMillisecond) << granted_ns << ", frame " << i;
      if (i > 1 || granted_ns == 1000 * kMillisecond) {
        EXPECT_GT(pace.stale_after_ns(), 1000 * kMillisecond) << granted_ns << ", frame " << i;
      }
      pace.observe(i * 1000 * kMillisecond);
    }
    EXPECT_EQ(pace.stall_timeout_ns(), 3000 * kMillisecond);
    EXPECT_EQ(pace.stale_after_ns(), 3000 * kMillisecond);
  }
}

TEST(FramePace, AllowsThreeSecondsForFirstFrames) {
  FramePace pace(33 * kMillisecond);
  EXPECT_EQ(pace.stall_timeout_ns(), 3000 * kMillisecond);
  pace.observe(0);
  pace.observe(33 * kMillisecond);
  EXPECT_EQ(pace.stall_timeout_ns(), 1000 * kMillisecond);
  pace.restart(33 * kMillisecond);
  EXPECT_EQ(pace.stall_timeout_ns(), 3000 * kMillisecond);
  pace.observe(9000 * kMillisecond);  // the time since the restart is not a frame interval
  EXPECT_EQ(pace.expected_ns(), 33 * kMillisecond);
}

TEST(FramePace, DoublesWaitAfterEachStartWithoutFrame) {
  FramePace pace(33 * kMillisecond);
  EXPECT_EQ(pace.stall_timeout_ns(), 3000 * kMillisecond);
  for (const std::int64_t wait_ms : {6000, 12000, 12000, 12000}) {
    pace.restart(33 * kMillisecond);
    EXPECT_EQ(pace.stall_timeout_ns(), wait_ms * kMillisecond);
  }
  pace.observe(0);
  pace.restart(33 * kMillisecond);
  EXPECT_EQ(pace.stall_timeout_ns(), 3000 * kMillisecond);
}

// Outages of 20 s do not raise the stale limit.
TEST(FramePace, KeepsStaleLimitAfterLongIntervals) {
  FramePace pace(33 * kMillisecond);
  std::int64_t at = 0;
  for (int i = 0; i < 10; ++i) pace.observe(at += 33 * kMillisecond);
  pace.observe(at += 20'000 * kMillisecond);
  EXPECT_EQ(pace.stale_after_ns(), 250 * kMillisecond);
  pace.observe(at += 20'000 * kMillisecond);
  EXPECT_EQ(pace.stale_after_ns(), 250 * kMillisecond);
}

}  // namespace
}  // namespace penumbra
