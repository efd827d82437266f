// Velocity of the camera from the poses of neighbouring frames.
#pragma once

#include <cstdint>
#include <optional>

#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

struct TimedPose {
  std::int64_t timestamp_ns = 0;
  std::optional<MapFromCamera> pose;  // if tags were measured
};

// Returns the velocity at `here`, T_map_camera * exp(t velocity) [m/s, rad/s], by differences to
// the neighbours: central if both are known, else one-sided. Ignores neighbours that are more than
// 0.2 s away. Zero if the velocity is unknown. `before` and `after` may be null.
[[nodiscard]] Vector6d velocity_at(const TimedPose* before, const TimedPose& here,
                                   const TimedPose* after);

}  // namespace penumbra
