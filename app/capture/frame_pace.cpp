#include "app/capture/frame_pace.hpp"

#include <algorithm>

namespace penumbra {
namespace {

constexpr std::int64_t kMissed = 3;  // intervals
constexpr std::int64_t kSilent_ns = 1'000'000'000;
constexpr std::int64_t kStarting_ns = 3'000'000'000;
constexpr int kMostDoublings = 2;  // of kStarting_ns
constexpr std::int64_t kStale_ns = 250'000'000;

}  // namespace

void FramePace::saw(std::int64_t timestamp_ns) {
  if (any_ && timestamp_ns > last_ns_) {
    intervals_ns_[intervals_++ % intervals_ns_.size()] = timestamp_ns - last_ns_;
  }
  last_ns_ = timestamp_ns;
  any_ = true;
  fruitless_starts_ = 0;
}

void FramePace::restart(std::int64_t granted_ns) {
  if (!any_) ++fruitless_starts_;
  granted_ns_ = granted_ns;
  intervals_ = 0;
  any_ = false;
}

std::int64_t FramePace::usual_ns() const {
  const std::size_t count = std::min(intervals_, intervals_ns_.size());
  if (count == 0) return granted_ns_;
  auto sorted = intervals_ns_;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>((count - 1) / 2);
  std::nth_element(sorted.begin(), middle, sorted.begin() + static_cast<std::ptrdiff_t>(count));
  return std::max(granted_ns_, *middle);
}

std::int64_t FramePace::silent_after_ns() const {
  const std::int64_t starting_ns = kStarting_ns << std::min(fruitless_starts_, kMostDoublings);
  const std::int64_t least = intervals_ == 0 ? starting_ns : kSilent_ns;
  return std::max(least, kMissed * usual_ns());
}

std::int64_t FramePace::stale_after_ns() const {
  return std::max(kStale_ns, kMissed * usual_ns());
}

}  // namespace penumbra
