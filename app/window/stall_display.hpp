// Frames on the screen while the camera's stream stalls.
#pragma once

#include <cstdint>
#include <optional>

#include "tracking/group_tracker.hpp"

namespace penumbra {

// Repeats the last frame with its pose held and fading, then without a pose: a stalled image must
// never look live.
class StallDisplay {
 public:
  void saw(const TrackedFrame& tracked) { last_ = tracked; }
  // Returns true if there is a frame to draw again.
  [[nodiscard]] bool holds() const { return last_.has_value(); }
  // The frame to draw after this stall, poses aged by it; empty if nothing changes on the screen.
  [[nodiscard]] std::optional<TrackedFrame> picture(std::int64_t silence_ns);

 private:
  std::optional<TrackedFrame> last_;
};

}  // namespace penumbra
