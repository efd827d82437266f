// Measures the frame rate.
#pragma once

#include <algorithm>
#include <cstddef>
#include <deque>

namespace penumbra {

class RateMeter {
 public:
  // Adds a frame at this time [ms] of a monotonic clock.
  void add(double at_ms) {
    at_ms_.push_back(at_ms);
    if (at_ms_.size() > kMaxFrames) at_ms_.pop_front();
  }
  // Returns the rate over the recent frames [1/s]; 0 for fewer than two. The next frame counts as
  // arriving now if it is late, so the rate decreases during a stall.
  [[nodiscard]] double per_s(double now_ms) const {
    if (at_ms_.size() < 2 || !(at_ms_.back() > at_ms_.front())) return 0.0;
    const auto intervals = static_cast<double>(at_ms_.size() - 1);
    const double measured = intervals / (at_ms_.back() - at_ms_.front());
    const double upper_bound = (intervals + 1.0) / std::max(now_ms - at_ms_.front(), 1e-9);
    return 1e3 * std::min(measured, upper_bound);
  }
  void restart() { at_ms_.clear(); }

 private:
  static constexpr std::size_t kMaxFrames = 30;
  std::deque<double> at_ms_;
};

}  // namespace penumbra
