// Finds camera parameters that are usable but likely wrong.
#pragma once

#include <optional>
#include <string>

#include "core/camera/camera_model.hpp"

namespace penumbra {

// Distance from the principal point [px] up to which the distortion is monotonic, along the x axis;
// infinite if it is monotonic everywhere.
[[nodiscard]] double monotonic_radius_px(const CameraModel& camera);

// Describes the first implausible parameter: field, value and likely cause, without the file's
// name. Returns nothing for a plausible camera. The checks, in this order:
// - the principal point lies outside the image (an off-centre crop of an image has that too),
// - fx and fy differ by more than a factor of 2,
// - the horizontal field of view is below 1 degree, above 170 degrees (pinhole models) or above 360
//   degrees (equidistant),
// - the distortion is non-monotonic nearer to the principal point than half of the image's shorter
//   side.
[[nodiscard]] std::optional<std::string> implausible_parameter(const CameraModel& camera);

}  // namespace penumbra
