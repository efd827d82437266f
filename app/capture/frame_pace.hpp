// How long a camera may give nothing before that means something: what is usual of it.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace penumbra {

// For one thread.
class FramePace {
 public:
  // `granted_ns`: the time between frames that the driver granted; 0 where it did not say.
  explicit FramePace(std::int64_t granted_ns = 0) : granted_ns_(granted_ns) {}

  // A frame of this time [ns].
  void saw(std::int64_t timestamp_ns);
  // The stream was set up again: the time since then is no interval.
  void restart(std::int64_t granted_ns);

  // As granted, or the (lower) median of the last intervals where that is longer.
  [[nodiscard]] std::int64_t usual_ns() const;
  // Without a frame and without an error for so long, a stream is set up again: a second, but three
  // intervals of a slow camera. Until the first interval is seen it is 3 s, for many cameras take
  // that long to start, and twice as long after each start that gave no frame (6 s, then 12 s).
  [[nodiscard]] std::int64_t silent_after_ns() const;
  // A picture that nothing followed for so long is no live one: 250 ms, but three intervals of a
  // slow camera.
  [[nodiscard]] std::int64_t stale_after_ns() const;

 private:
  std::int64_t granted_ns_;
  std::array<std::int64_t, 5> intervals_ns_{};
  std::size_t intervals_ = 0;  // seen since the restart
  std::int64_t last_ns_ = 0;
  bool any_ = false;          // a frame was seen since the restart
  int fruitless_starts_ = 0;  // in a row, without a frame
};

}  // namespace penumbra
