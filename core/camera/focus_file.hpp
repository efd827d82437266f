// The focus that a camera file was calibrated at.
#pragma once

#include <filesystem>
#include <optional>

namespace penumbra {

// Returns `focus_position`, in the units of the camera's control; nothing if the file has none.
[[nodiscard]] std::optional<double> load_focus_position(const std::filesystem::path& camera_file);

}  // namespace penumbra
