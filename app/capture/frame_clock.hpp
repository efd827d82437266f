// A driver's sequence numbers and timestamps -> numbers that only grow, and what was lost.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace penumbra {

struct FrameStamp {
  std::uint64_t sequence = 0;      // from 0; lost frames leave gaps
  std::int64_t timestamp_ns = 0;   // monotonic clock, always growing
  std::uint32_t lost_counted = 0;  // frames that the driver's numbers say are missing before this
  // Frames that only the time between others says are missing. Reported with the first frame after
  // the gap that came in time again.
  std::uint32_t lost_silent = 0;
  bool bad_time = false;  // the driver's time could not be true; the time of arrival stands for it
  // The camera has become slower than before: its interval now [ns]. 0 for every other frame.
  std::int64_t slower_interval_ns = 0;
};

class FrameClock {
 public:
  // `interval_ns`: the time between frames that the driver granted; 0 where it did not say.
  explicit FrameClock(std::int64_t interval_ns = 0) : granted_ns_(interval_ns) {}

  // `driver_ns`: the driver's timestamp, on the monotonic clock if `monotonic`. `arrival_ns`: that
  // clock now.
  [[nodiscard]] FrameStamp next(std::uint32_t driver_sequence, std::int64_t driver_ns,
                                bool monotonic, std::int64_t arrival_ns);
  // The stream was set up again: the driver counts from anywhere, and the time since then is no
  // gap. Numbers and times keep growing.
  void restart(std::int64_t interval_ns);

 private:
  // The usual time between frames [ns]: what was granted, or the median of the last ones where that
  // is longer (a dark room makes many cameras slower than they promised).
  [[nodiscard]] std::int64_t usual_interval_ns() const;
  // Decides whether an interval [ns] has lost frames in it. `consecutive`: the driver's numbers
  // show no loss.
  void judge_interval(std::int64_t interval_ns, bool consecutive, FrameStamp& stamp);

  std::int64_t granted_ns_ = 0;
  std::array<std::int64_t, 15> intervals_ns_{};
  std::size_t intervals_ = 0;       // seen since the restart
  std::uint32_t long_run_ = 0;      // intervals in a row that were long
  std::uint64_t pending_lost_ = 0;  // frames missing in these, if they are gaps
  bool any_ = false;                // a frame was seen at all
  bool continuous_ = false;         // a frame was seen since the restart
  std::uint32_t driver_sequence_ = 0;
  std::uint64_t sequence_ = 0;
  std::int64_t timestamp_ns_ = 0;
  std::int64_t believed_ns_ = 0;  // the last of the driver's times that could be true
  bool any_believed_ = false;
  bool last_bad_ = false;
};

}  // namespace penumbra
