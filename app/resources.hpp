// Finds the program's own scenes, models and recordings.
#pragma once

#include <filesystem>
#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// Returns the folder that contains the bundled scenes/: $PENUMBRA_RESOURCES if it is set, else the
// installed data folder, else the nearest such folder above the program.
[[nodiscard]] Result<std::filesystem::path> find_resources();
// Like find_resources(), for a program at `program`. `given`: $PENUMBRA_RESOURCES, or nullptr.
[[nodiscard]] Result<std::filesystem::path> find_resources_of(const std::filesystem::path& program,
                                                              const char* given);

// Returns the folder of a bundled recording. Installations may lack the recordings.
[[nodiscard]] Result<std::filesystem::path> find_bundled_recording(std::string_view name);
// Like find_bundled_recording(), in a folder that find_resources() returned.
[[nodiscard]] Result<std::filesystem::path> find_bundled_recording_in(
    const std::filesystem::path& resources, std::string_view name);

}  // namespace penumbra
