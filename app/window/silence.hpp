// What is on the screen while the camera gives no whole picture.
#pragma once

#include <cstdint>
#include <optional>

#include "tracking/group_tracker.hpp"

namespace penumbra {

// The last picture, its pose held and fading, then no pose: never a still picture that looks live.
class Silence {
 public:
  void saw(const TrackedFrame& tracked) { last_ = tracked; }
  // Whether what is on the screen may still be drawn again.
  [[nodiscard]] bool holds() const { return last_.has_value(); }
  // What to draw after so long a silence; nothing when that is on the screen already. Poses are as
  // old as they were when the picture came, and the silence more.
  [[nodiscard]] std::optional<TrackedFrame> picture(std::int64_t silence_ns);

 private:
  std::optional<TrackedFrame> last_;
};

}  // namespace penumbra
