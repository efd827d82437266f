// The camera that a command names by a file and --camera-name.
#pragma once

#include <filesystem>
#include <string>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"

namespace penumbra {

// Loads the camera and logs the warnings of load_camera_file(). `name`: as there.
[[nodiscard]] Result<CameraModel> load_chosen_camera(const std::filesystem::path& file,
                                                     const std::string& name);

}  // namespace penumbra
