#include "app/capture/frame_clock.hpp"

#include <algorithm>
#include <limits>

namespace penumbra {
namespace {

// A frame is stamped before it arrives, and no driver keeps one for longer than this.
constexpr std::int64_t kOldest_ns = 10'000'000'000;
// Numbers that jump by more than this were set back, not lost.
constexpr std::uint32_t kMostLost = 1U << 20U;
// A pause of this many intervals, with consecutive numbers, has a lost frame in it.
constexpr double kGap = 1.6;

}  // namespace

std::int64_t FrameClock::usual_interval_ns() const {
  const std::size_t count = std::min(intervals_, intervals_ns_.size());
  if (count < intervals_ns_.size()) return granted_ns_;
  auto sorted = intervals_ns_;
  std::nth_element(sorted.begin(), sorted.begin() + sorted.size() / 2, sorted.end());
  return std::max(granted_ns_, sorted[sorted.size() / 2]);
}

FrameStamp FrameClock::next(std::uint32_t driver_sequence, std::int64_t driver_ns, bool monotonic,
                            std::int64_t arrival_ns) {
  FrameStamp stamp;
  stamp.timestamp_ns = driver_ns;
  if (monotonic) {
    // Not of the future, but for drivers that name the moment at which the frame is going to end;
    // and after the last true one: what stood for a bad time is no measure.
    const bool possible = driver_ns <= arrival_ns + usual_interval_ns() &&
                          driver_ns >= arrival_ns - kOldest_ns &&
                          (!any_believed_ || driver_ns > believed_ns_);
    stamp.bad_time = !possible;
    if (possible) {
      believed_ns_ = driver_ns;
      any_believed_ = true;
    }
  }
  if (!monotonic || stamp.bad_time) stamp.timestamp_ns = arrival_ns;
  if (any_) stamp.timestamp_ns = std::max(stamp.timestamp_ns, timestamp_ns_ + 1);

  if (any_) {
    std::uint32_t step = 1;
    if (continuous_) {
      const std::uint32_t difference = driver_sequence - driver_sequence_;  // wraps as it should
      if (difference >= 1 && difference <= kMostLost) step = difference;
    }
    stamp.lost_counted = step - 1;
    const std::int64_t interval_ns = stamp.timestamp_ns - timestamp_ns_;
    if (continuous_ && !stamp.bad_time && !last_bad_) {
      const std::int64_t usual_ns = usual_interval_ns();
      if (step == 1 && monotonic && usual_ns > 0 &&
          static_cast<double>(interval_ns) > kGap * static_cast<double>(usual_ns)) {
        stamp.lost_silent = static_cast<std::uint32_t>(
            std::min<std::int64_t>((interval_ns + usual_ns / 2) / usual_ns - 1,
                                   std::numeric_limits<std::uint32_t>::max()));
      }
      intervals_ns_[intervals_++ % intervals_ns_.size()] = interval_ns / step;
    }
    sequence_ += step;
  }
  stamp.sequence = sequence_;
  timestamp_ns_ = stamp.timestamp_ns;
  driver_sequence_ = driver_sequence;
  last_bad_ = stamp.bad_time;
  any_ = continuous_ = true;
  return stamp;
}

void FrameClock::restart(std::int64_t interval_ns) {
  granted_ns_ = interval_ns;
  intervals_ = 0;
  continuous_ = false;
  last_bad_ = false;
}

}  // namespace penumbra
