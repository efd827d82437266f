// The clocks of a live session: the monotonic clock for timestamps, and UTC for other logs.
#pragma once

#include <cstdint>
#include <functional>

namespace penumbra {

// The monotonic clock, which drivers use for timestamps.
[[nodiscard]] std::int64_t monotonic_ns();

// One reading of UTC, between two readings of the monotonic clock.
struct ClockReading {
  std::int64_t before_ns = 0, after_ns = 0;  // monotonic clock
  std::int64_t utc_ns = 0;                   // CLOCK_REALTIME: since 1970
};
[[nodiscard]] ClockReading read_clocks();

// Returns UTC at a recent time of the monotonic clock: that time plus the present difference of
// both clocks. If UTC was set in between, the result is on the clock as set. Takes several
// readings, and uses the one with the smallest interval, because the thread may be suspended within
// a reading.
[[nodiscard]] std::int64_t utc_at(std::int64_t time_ns,
                                  const std::function<ClockReading()>& read = read_clocks);

}  // namespace penumbra
