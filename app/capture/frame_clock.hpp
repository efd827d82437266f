// Converts a driver's sequence numbers and timestamps to increasing ones, and counts lost frames.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace penumbra {

struct FrameStamp {
  std::uint64_t sequence = 0;      // counts from 0; lost frames leave gaps
  std::int64_t timestamp_ns = 0;   // monotonic clock, increasing
  std::uint32_t lost_counted = 0;  // lost before this frame, by the driver's sequence numbers
  // Frames lost according to the timestamps only; reported with the first punctual frame after.
  std::uint32_t lost_by_time = 0;
  bool bad_time = false;  // the driver's time was impossible; timestamp_ns is the time of arrival
  // New interval [ns] if the camera has become slower with this frame, else 0.
  std::int64_t slower_interval_ns = 0;
};

class FrameClock {
 public:
  // `interval_ns`: the granted time between frames; 0 if unknown.
  explicit FrameClock(std::int64_t interval_ns = 0) : granted_ns_(interval_ns) {}

  // Returns the stamp of the next frame. `driver_ns`: the driver's timestamp; `monotonic`: its
  // clock is the monotonic one. `arrival_ns`: time of arrival on the monotonic clock.
  [[nodiscard]] FrameStamp next(std::uint32_t driver_sequence, std::int64_t driver_ns,
                                bool monotonic, std::int64_t arrival_ns);
  // Call this when the stream is restarted: the driver may then count from any number, and the
  // pause is not a gap. The returned sequence numbers and times keep increasing.
  void restart(std::int64_t interval_ns);

 private:
  // Expected time between frames [ns]: the granted interval, or the median of the recent intervals
  // if that is longer (many cameras slow down in a dark room).
  [[nodiscard]] std::int64_t expected_interval_ns() const;
  // Decides whether frames were lost during an interval [ns]. `consecutive`: the driver's sequence
  // numbers show no loss.
  void check_interval(std::int64_t interval_ns, bool consecutive, FrameStamp& stamp);

  std::int64_t granted_ns_ = 0;
  std::array<std::int64_t, 15> intervals_ns_{};
  std::size_t intervals_ = 0;       // count since the restart
  std::uint32_t long_run_ = 0;      // consecutive long intervals
  std::uint64_t pending_lost_ = 0;  // frames lost in the long intervals, if they are gaps
  bool any_ = false;                // a frame has arrived
  bool continuous_ = false;         // a frame arrived since the restart
  std::uint32_t driver_sequence_ = 0;
  std::uint64_t sequence_ = 0;
  std::int64_t timestamp_ns_ = 0;
  std::int64_t plausible_ns_ = 0;  // previous plausible time of the driver
  bool any_plausible_ = false;
  bool last_bad_ = false;
};

// Decides which pause between frames counts as a fault. Not thread-safe.
class FramePace {
 public:
  explicit FramePace(std::int64_t granted_ns = 0) : granted_ns_(granted_ns) {}

  void observe(std::int64_t timestamp_ns);
  // Call this when the stream is restarted: the pause is not an interval.
  void restart(std::int64_t granted_ns);

  // The granted interval, or the (lower) median of the recent intervals if that is longer.
  [[nodiscard]] std::int64_t expected_ns() const;
  // A stalled stream is restarted after this time: 1 s, or three intervals of a slow camera. Before
  // the first interval it is 3 s, because many cameras start slowly. It doubles after a restart
  // without a frame (6 s, then 12 s).
  [[nodiscard]] std::int64_t stall_timeout_ns() const;
  // The newest frame is stale after this time: 250 ms, or three intervals of a slow camera.
  [[nodiscard]] std::int64_t stale_after_ns() const;

 private:
  std::int64_t granted_ns_;
  std::array<std::int64_t, 5> intervals_ns_{};
  std::size_t intervals_ = 0;  // count since the restart
  std::int64_t last_ns_ = 0;
  bool any_ = false;       // a frame arrived since the restart
  int failed_starts_ = 0;  // consecutive starts without a frame
};

}  // namespace penumbra
