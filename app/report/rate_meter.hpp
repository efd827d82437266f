// How many pictures come per second.
#pragma once

#include <cstddef>
#include <deque>

namespace penumbra {

class RateMeter {
 public:
  // A picture came at this time [ms], of a clock that only goes on.
  void add(double at_ms);
  // Over the last pictures [1/s]; 0 for fewer than two. Where the next one is late, as if it came
  // now: the rate falls while nothing comes.
  [[nodiscard]] double per_s(double now_ms) const;
  void restart() { at_ms_.clear(); }

 private:
  static constexpr std::size_t kMostPictures = 30;
  std::deque<double> at_ms_;
};

}  // namespace penumbra
