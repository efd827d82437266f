// Camera models in files.
#pragma once

#include <filesystem>

#include "core/camera_model.hpp"

namespace penumbra {

// ROS camera_info YAML: image_width, image_height, camera_matrix.data, distortion_model (or
// camera_model), distortion_coefficients.data; optional tone_curve, rolling_shutter_row_s. Other
// keys are ignored (also the flat fx: ... of some recordings: camera_matrix wins). Errors name file
// and field. An unknown distortion model is refused by name.
[[nodiscard]] Result<CameraModel> load_camera(const std::filesystem::path& file);
[[nodiscard]] Result<void> save_camera(const std::filesystem::path& file,
                                       const CameraModel& camera);

}  // namespace penumbra
