#include "app/capture/frame_clock.hpp"

#include <algorithm>
#include <limits>

namespace penumbra {
namespace {

// Longest plausible time between a frame's timestamp and its arrival.
constexpr std::int64_t kMaxAge_ns = 10'000'000'000;
// If the sequence number jumps by more than this, the driver has reset it.
constexpr std::uint32_t kMaxLost = 1U << 20U;
// A pause of this many intervals between consecutive sequence numbers implies a lost frame.
constexpr double kGapIntervals = 1.6;
// This number of consecutive long intervals means a slower camera, not gaps.
constexpr std::uint32_t kSlowerAfter = 5;
constexpr std::int64_t kStallIntervals = 3;  // intervals without a frame that count as a stall
constexpr std::int64_t kMinStall_ns = 1'000'000'000;  // minimum of stall_timeout_ns()
constexpr std::int64_t kStarting_ns = 3'000'000'000;  // its minimum before the first interval
constexpr int kMaxDoublings = 2;                      // largest number of doublings of kStarting_ns
constexpr std::int64_t kMinStale_ns = 250'000'000;    // minimum of stale_after_ns()

// Returns `granted_ns` or, if longer, the n-th smallest (from 0) of the first `count` intervals.
template <std::size_t N>
std::int64_t expected_interval(std::int64_t granted_ns, std::array<std::int64_t, N> intervals_ns,
                               std::size_t count, std::size_t n) {
  const auto nth = intervals_ns.begin() + static_cast<std::ptrdiff_t>(n);
  std::nth_element(intervals_ns.begin(), nth,
                   intervals_ns.begin() + static_cast<std::ptrdiff_t>(count));
  return std::max(granted_ns, *nth);
}

}  // namespace

std::int64_t FrameClock::expected_interval_ns() const {
  const std::size_t count = std::min(intervals_, intervals_ns_.size());
  if (count < kSlowerAfter) return granted_ns_;
  return expected_interval(granted_ns_, intervals_ns_, count, count / 2);
}

void FrameClock::check_interval(std::int64_t interval_ns, bool consecutive, FrameStamp& stamp) {
  const std::int64_t expected_ns = expected_interval_ns();
  const bool is_long =
      consecutive && expected_ns > 0 &&
      static_cast<double>(interval_ns) > kGapIntervals * static_cast<double>(expected_ns);
  if (!is_long) {
    stamp.lost_by_time = static_cast<std::uint32_t>(
        std::min<std::uint64_t>(pending_lost_, std::numeric_limits<std::uint32_t>::max()));
    pending_lost_ = long_run_ = 0;
    return;
  }
  pending_lost_ += static_cast<std::uint64_t>((interval_ns + expected_ns / 2) / expected_ns - 1);
  if (++long_run_ < kSlowerAfter) return;
  // Keeps only the slow intervals, including this one: their median becomes the expected one.
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
    // A plausible time is later than the previous plausible one, at most kMaxAge_ns old, and at
    // most one interval ahead of the arrival, because some drivers stamp the end of the exposure.
    const bool possible = driver_ns <= arrival_ns + expected_interval_ns() &&
                          driver_ns >= arrival_ns - kMaxAge_ns &&
                          (!any_plausible_ || driver_ns > plausible_ns_);
    stamp.bad_time = !possible;
    if (possible) {
      plausible_ns_ = driver_ns;
      any_plausible_ = true;
    }
  }
  if (!monotonic || stamp.bad_time) stamp.timestamp_ns = arrival_ns;
  if (any_) stamp.timestamp_ns = std::max(stamp.timestamp_ns, timestamp_ns_ + 1);

  if (any_) {
    std::uint32_t step = 1;
    if (continuous_) {
      const std::uint32_t difference = driver_sequence - driver_sequence_;  // wraps
      if (difference >= 1 && difference <= kMaxLost) step = difference;
    }
    stamp.lost_counted = step - 1;
    const std::int64_t interval_ns = stamp.timestamp_ns - timestamp_ns_;
    if (continuous_ && !stamp.bad_time && !last_bad_) {
      check_interval(interval_ns, step == 1 && monotonic, stamp);
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

void FramePace::observe(std::int64_t timestamp_ns) {
  if (any_ && timestamp_ns > last_ns_) {
    intervals_ns_[intervals_++ % intervals_ns_.size()] = timestamp_ns - last_ns_;
  }
  last_ns_ = timestamp_ns;
  any_ = true;
  failed_starts_ = 0;
}

void FramePace::restart(std::int64_t granted_ns) {
  if (!any_) ++failed_starts_;
  granted_ns_ = granted_ns;
  intervals_ = 0;
  any_ = false;
}

std::int64_t FramePace::expected_ns() const {
  const std::size_t count = std::min(intervals_, intervals_ns_.size());
  if (count == 0) return granted_ns_;
  return expected_interval(granted_ns_, intervals_ns_, count, (count - 1) / 2);
}

std::int64_t FramePace::stall_timeout_ns() const {
  const std::int64_t starting_ns = kStarting_ns << std::min(failed_starts_, kMaxDoublings);
  const std::int64_t shortest_ns = intervals_ == 0 ? starting_ns : kMinStall_ns;
  return std::max(shortest_ns, kStallIntervals * expected_ns());
}

std::int64_t FramePace::stale_after_ns() const {
  return std::max(kMinStale_ns, kStallIntervals * expected_ns());
}

}  // namespace penumbra
