// Cameras of EuRoC/ASL data sets.
#pragma once

#include <filesystem>

#include "core/camera_model.hpp"

namespace penumbra {

// mav0/cam0/sensor.yaml: resolution [width, height], camera_model pinhole, intrinsics [fu, fv, cu,
// cv], distortion_model radial-tangential (plumb_bob with k3 = 0) or equidistant (fisheye),
// distortion_coefficients of 4 numbers. Other keys are ignored. Errors name file and field.
[[nodiscard]] Result<CameraModel> load_euroc_sensor(const std::filesystem::path& file);

}  // namespace penumbra
