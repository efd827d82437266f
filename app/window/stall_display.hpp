// Chooses the frames on the screen while the camera's stream stalls.
#pragma once

#include <cstdint>
#include <optional>

#include "tracking/group_tracker.hpp"

namespace penumbra {

// Repeats the latest frame while its pose ages and the objects fade out, then without a pose, so
// that a stalled image does not look live.
class StallDisplay {
 public:
  void observe(const TrackedFrame& tracked) { last_ = tracked; }
  // Returns true if a frame can be drawn again.
  [[nodiscard]] bool holds() const { return last_.has_value(); }
  // Returns the frame to draw after a stall of `stall_ns`, which is added to the age of its
  // poses. Returns nullopt if the screen does not change.
  [[nodiscard]] std::optional<TrackedFrame> frame_to_show(std::int64_t stall_ns);

 private:
  std::optional<TrackedFrame> last_;
};

}  // namespace penumbra
