// Converts a driver's sequence numbers and timestamps to increasing ones, and counts lost frames.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace penumbra {

struct FrameStamp {
  std::uint64_t sequence = 0;      // from 0; lost frames leave gaps
  std::int64_t timestamp_ns = 0;   // monotonic clock, increasing
  std::uint32_t lost_counted = 0;  // frames missing before this one by the driver's numbers
  // Frames missing only by the times; reported with the first punctual frame after the gap.
  std::uint32_t lost_silent = 0;
  bool bad_time = false;  // the driver's time was impossible; the time of arrival replaces it
  // New interval [ns] if the camera has become slower; 0 for every other frame.
  std::int64_t slower_interval_ns = 0;
};

class FrameClock {
 public:
  // `interval_ns`: the granted time between frames; 0 if unknown.
  explicit FrameClock(std::int64_t interval_ns = 0) : granted_ns_(interval_ns) {}

  // `driver_ns`: the driver's timestamp, on the monotonic clock if `monotonic`. `arrival_ns`: that
  // clock now.
  [[nodiscard]] FrameStamp next(std::uint32_t driver_sequence, std::int64_t driver_ns,
                                bool monotonic, std::int64_t arrival_ns);
  // The stream was restarted: the driver counts from any number, and the pause is no gap. Numbers
  // and times keep increasing.
  void restart(std::int64_t interval_ns);

 private:
  // Usual time between frames [ns]: as granted, or the median of the last ones if that is longer
  // (many cameras slow down in a dark room).
  [[nodiscard]] std::int64_t usual_interval_ns() const;
  // Decides whether an interval [ns] has lost frames in it. `consecutive`: the driver's numbers
  // show no loss.
  void judge_interval(std::int64_t interval_ns, bool consecutive, FrameStamp& stamp);

  std::int64_t granted_ns_ = 0;
  std::array<std::int64_t, 15> intervals_ns_{};
  std::size_t intervals_ = 0;       // seen since the restart
  std::uint32_t long_run_ = 0;      // consecutive long intervals
  std::uint64_t pending_lost_ = 0;  // frames missing in these, if they are gaps
  bool any_ = false;                // a frame was seen
  bool continuous_ = false;         // a frame was seen since the restart
  std::uint32_t driver_sequence_ = 0;
  std::uint64_t sequence_ = 0;
  std::int64_t timestamp_ns_ = 0;
  std::int64_t believed_ns_ = 0;  // last possible time of the driver
  bool any_believed_ = false;
  bool last_bad_ = false;
};

// Decides how long a camera may pause between frames before that is a fault. For one thread.
class FramePace {
 public:
  explicit FramePace(std::int64_t granted_ns = 0) : granted_ns_(granted_ns) {}

  void saw(std::int64_t timestamp_ns);
  // The stream was restarted: the pause is no interval.
  void restart(std::int64_t granted_ns);

  // As granted, or the (lower) median of the last intervals if that is longer.
  [[nodiscard]] std::int64_t usual_ns() const;
  // A stream without frames and errors is restarted after this time: 1 s, or three intervals of a
  // slow camera. Before the first interval 3 s, as many cameras start slowly, and twice as long
  // after each restart without a frame (6 s, then 12 s).
  [[nodiscard]] std::int64_t silent_after_ns() const;
  // The last frame is out of date after this time: 250 ms, or three intervals of a slow camera.
  [[nodiscard]] std::int64_t stale_after_ns() const;

 private:
  std::int64_t granted_ns_;
  std::array<std::int64_t, 5> intervals_ns_{};
  std::size_t intervals_ = 0;  // seen since the restart
  std::int64_t last_ns_ = 0;
  bool any_ = false;          // a frame was seen since the restart
  int fruitless_starts_ = 0;  // consecutive starts without a frame
};

}  // namespace penumbra
