// Finds camera parameters that are valid but probably wrong.
#pragma once

#include <optional>
#include <string>

#include "core/camera/camera_model.hpp"

namespace penumbra {

// Distance from the principal point [px] up to which the distortion is monotonic, along the x axis;
// infinite if it is monotonic everywhere.
[[nodiscard]] double monotonic_radius_px(const CameraModel& camera);

// Returns field, value and likely cause of the first implausible parameter, or nullopt. The checks,
// in this order:
// - the principal point lies outside the image (possible for an off-centre crop),
// - fx and fy differ by more than a factor of 2,
// - the horizontal field of view is below 1 degree, above 170 degrees (pinhole models) or above 360
//   degrees (equidistant),
// - monotonic_radius_px() is less than half of the image's shorter side.
[[nodiscard]] std::optional<std::string> implausible_parameter(const CameraModel& camera);

}  // namespace penumbra
