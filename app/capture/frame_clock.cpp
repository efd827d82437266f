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
// So many long intervals in a row are no gaps but a slower camera.
constexpr std::uint32_t kSlowerAfter = 5;

}  // namespace

std::int64_t FrameClock::usual_interval_ns() const {
  const std::size_t count = std::min(intervals_, intervals_ns_.size());
  if (count < kSlowerAfter) return granted_ns_;
  auto sorted = intervals_ns_;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(count / 2);
  std::nth_element(sorted.begin(), middle, sorted.begin() + static_cast<std::ptrdiff_t>(count));
  return std::max(granted_ns_, *middle);
}

void FrameClock::judge_interval(std::int64_t interval_ns, bool consecutive, FrameStamp& stamp) {
  const std::int64_t usual_ns = usual_interval_ns();
  const bool is_long = consecutive && usual_ns > 0 &&
                       static_cast<double>(interval_ns) > kGap * static_cast<double>(usual_ns);
  if (!is_long) {
    stamp.lost_silent = static_cast<std::uint32_t>(
        std::min<std::uint64_t>(pending_lost_, std::numeric_limits<std::uint32_t>::max()));
    pending_lost_ = long_run_ = 0;
    return;
  }
  pending_lost_ += static_cast<std::uint64_t>((interval_ns + usual_ns / 2) / usual_ns - 1);
  if (++long_run_ < kSlowerAfter) return;
  // Only the slow intervals are kept: their median is the usual one from now on. This interval is
  // the last of them.
  std::array<std::int64_t, kSlowerAfter> slow_ns{};
  slow_ns.back() = interval_ns;
  for (std::size_t i = 0; i + 1 < kSlowerAfter; ++i) {
    slow_ns[i] = intervals_ns_[(intervals_ - 1 - i) % intervals_ns_.size()];
  }
  std::copy(slow_ns.begin(), slow_ns.end() - 1, intervals_ns_.begin());
  intervals_ = kSlowerAfter - 1;
  pending_lost_ = long_run_ = 0;
  std::nth_element(slow_ns.begin(), slow_ns.begin() + kSlowerAfter / 2, slow_ns.end());
  stamp.slower_interval_ns = slow_ns[kSlowerAfter / 2];
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
      judge_interval(interval_ns, step == 1 && monotonic, stamp);
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
  long_run_ = 0;
  pending_lost_ = 0;
  continuous_ = false;
  last_bad_ = false;
}

}  // namespace penumbra
