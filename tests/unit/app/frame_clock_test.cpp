#include "app/capture/frame_clock.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>

namespace penumbra {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kStart = 5'000'000 * kMs;

// A camera with a frame every 10 ms that arrives 2 ms after its timestamp.
class Camera {
 public:
  FrameStamp frame(std::uint32_t sequence, std::int64_t at_ms) {
    return clock.next(sequence, kStart + at_ms * kMs, true, kStart + (at_ms + 2) * kMs);
  }
  FrameClock clock{10 * kMs};
};

TEST(FrameClock, CountsFromZeroWithDriverTimestamps) {
  Camera camera;
  for (std::uint32_t i = 0; i < 50; ++i) {
    const FrameStamp stamp = camera.frame(100 + i, 10 * i);
    EXPECT_EQ(stamp.sequence, i);
    EXPECT_EQ(stamp.timestamp_ns, kStart + 10 * i * kMs);
    EXPECT_EQ(stamp.lost_counted + stamp.lost_by_time, 0U);
    EXPECT_FALSE(stamp.bad_time);
  }
}

TEST(FrameClock, CountsSequenceGapOnce) {
  Camera camera;
  (void)camera.frame(5, 0);
  const FrameStamp stamp = camera.frame(9, 40);
  EXPECT_EQ(stamp.lost_counted, 3U);
  EXPECT_EQ(stamp.lost_by_time, 0U);
  EXPECT_EQ(stamp.sequence, 4U);
}

TEST(FrameClock, CountsTimestampGapOnceFramesAreRegularAgain) {
  Camera camera;
  for (std::uint32_t i = 0; i < 20; ++i) (void)camera.frame(i, 10 * i);
  const FrameStamp late = camera.frame(20, 240);
  EXPECT_EQ(late.lost_counted, 0U);
  EXPECT_EQ(late.lost_by_time, 0U);
  EXPECT_EQ(camera.frame(21, 250).lost_by_time, 4U);
  EXPECT_EQ(camera.frame(22, 260).lost_by_time, 0U);
}

TEST(FrameClock, SumsConsecutiveTimestampGaps) {
  Camera camera;
  for (std::uint32_t i = 0; i < 20; ++i) (void)camera.frame(i, 10 * i);
  EXPECT_EQ(camera.frame(20, 220).lost_by_time, 0U);  // 2 frames missing so far
  EXPECT_EQ(camera.frame(21, 240).lost_by_time, 0U);  // 1 more frame missing
  EXPECT_EQ(camera.frame(22, 290).lost_by_time, 0U);  // 4 more frames missing
  EXPECT_EQ(camera.frame(23, 300).lost_by_time, 7U);
}

TEST(FrameClock, CountsNoGapForCameraSlowerThanGranted) {
  for (const std::int64_t interval_ms : {17, 20, 30, 100, 1000}) {
    Camera camera;
    int reported = 0;
    for (std::uint32_t i = 0; i < 100; ++i) {
      const FrameStamp stamp = camera.frame(i, interval_ms * i);
      EXPECT_EQ(stamp.lost_by_time, 0U) << interval_ms << " ms, frame " << i;
      if (stamp.slower_interval_ns == 0) continue;
      EXPECT_EQ(stamp.slower_interval_ns, interval_ms * kMs);
      ++reported;
    }
    EXPECT_EQ(reported, 1) << interval_ms;
    // At the slow rate, missing frames are still counted.
    EXPECT_EQ(camera.frame(100, interval_ms * 103).lost_by_time, 0U);
    EXPECT_EQ(camera.frame(101, interval_ms * 104).lost_by_time, 3U);
  }
}

TEST(FrameClock, CountsNoGapWhenRateHalves) {
  Camera camera;
  for (std::uint32_t i = 0; i < 50; ++i) (void)camera.frame(i, 10 * i);
  std::int64_t slower_ns = 0;
  for (std::uint32_t i = 0; i < 50; ++i) {
    const FrameStamp stamp = camera.frame(50 + i, 490 + 20 * (i + 1));
    EXPECT_EQ(stamp.lost_by_time, 0U) << i;
    slower_ns = std::max(slower_ns, stamp.slower_interval_ns);
  }
  EXPECT_EQ(slower_ns, 20 * kMs);
}

TEST(FrameClock, KeepsRateWhenDriverCountsLosses) {
  Camera camera;
  for (std::uint32_t i = 0; i < 100; ++i) {
    const FrameStamp stamp = camera.frame(3 * i, 30 * i);
    EXPECT_EQ(stamp.slower_interval_ns, 0);
    EXPECT_EQ(stamp.lost_by_time, 0U);
    EXPECT_EQ(stamp.lost_counted, i == 0 ? 0U : 2U);
  }
}

TEST(FrameClock, WrapsSequenceAt32Bits) {
  Camera camera;
  (void)camera.frame(0xFFFFFFFFU, 0);
  const FrameStamp stamp = camera.frame(0, 10);
  EXPECT_EQ(stamp.lost_counted, 0U);
  EXPECT_EQ(stamp.sequence, 1U);
}

TEST(FrameClock, CountsNoGapForDecreasingOrRepeatedSequence) {
  Camera camera;
  (void)camera.frame(1000, 0);
  EXPECT_EQ(camera.frame(3, 10).sequence, 1U);
  EXPECT_EQ(camera.frame(3, 20).sequence, 2U);
  EXPECT_EQ(camera.frame(4, 30).lost_counted, 0U);
}

TEST(FrameClock, ReplacesImplausibleTimestampByArrival) {
  Camera camera;
  (void)camera.frame(0, 0);
  // Timestamps: just before the end of 64-bit nanoseconds, then wrapped to the beginning, then
  // backwards.
  std::int64_t last = kStart;
  std::int64_t arrival = kStart;
  for (const std::int64_t driver_ns : {INT64_MAX - 5, std::int64_t{3}, kStart - 10 * kMs}) {
    arrival += 10 * kMs;
    const FrameStamp stamp = camera.clock.next(1, driver_ns, true, arrival);
    EXPECT_TRUE(stamp.bad_time) << driver_ns;
    EXPECT_EQ(stamp.timestamp_ns, arrival);
    EXPECT_GT(stamp.timestamp_ns, last);
    EXPECT_EQ(stamp.lost_by_time, 0U);
    last = stamp.timestamp_ns;
  }
}

// A wrong timestamp, too early or too late, must not change the other timestamps.
TEST(FrameClock, KeepsLaterTimestampsAfterWrongTimestamp) {
  for (const std::int64_t wrong_ms : {std::int64_t{500}, std::int64_t{-50}}) {
    Camera camera;
    for (std::uint32_t i = 0; i < 20; ++i) (void)camera.frame(i, 10 * i);
    // The frame arrives 35 ms late, after the following ones are due.
    const FrameStamp bad =
        camera.clock.next(20, kStart + (200 + wrong_ms) * kMs, true, kStart + 235 * kMs);
    EXPECT_TRUE(bad.bad_time) << wrong_ms;
    EXPECT_EQ(bad.timestamp_ns, kStart + 235 * kMs);
    std::int64_t last = bad.timestamp_ns;
    for (std::uint32_t i = 21; i < 40; ++i) {
      const FrameStamp stamp = camera.frame(i, 10 * i);
      EXPECT_FALSE(stamp.bad_time) << wrong_ms << ", frame " << i;
      EXPECT_GT(stamp.timestamp_ns, last);
      if (i > 23) {
        EXPECT_EQ(stamp.timestamp_ns, kStart + 10 * i * kMs);
      }
      last = stamp.timestamp_ns;
    }
  }
}

// Some drivers report the end of the exposure, which is later than the frame's arrival.
TEST(FrameClock, AcceptsTimestampAtEndOfFrame) {
  Camera camera;
  for (std::uint32_t i = 0; i < 20; ++i) {
    const std::int64_t now = kStart + 10 * i * kMs;
    EXPECT_FALSE(camera.clock.next(i, now + 9 * kMs, true, now).bad_time) << i;
  }
}

TEST(FrameClock, ReturnsIncreasingTimestamps) {
  FrameClock clock(10 * kMs);
  const FrameStamp first = clock.next(0, 0, false, kStart);
  const FrameStamp second = clock.next(1, 0, false, kStart);
  EXPECT_EQ(first.timestamp_ns, kStart);
  EXPECT_GT(second.timestamp_ns, first.timestamp_ns);
  EXPECT_FALSE(second.bad_time);  // this driver gives no timestamps
}

TEST(FrameClock, CountsNoGapAcrossRestart) {
  Camera camera;
  for (std::uint32_t i = 0; i < 20; ++i) (void)camera.frame(i, 10 * i);
  camera.clock.restart(10 * kMs);
  const FrameStamp stamp = camera.frame(500, 5000);
  EXPECT_EQ(stamp.sequence, 20U);
  EXPECT_EQ(stamp.lost_counted + stamp.lost_by_time, 0U);
  EXPECT_EQ(stamp.timestamp_ns, kStart + 5000 * kMs);
}

}  // namespace
}  // namespace penumbra
