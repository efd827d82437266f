// Finds the program's own scenes, models and recordings.
#pragma once

#include <filesystem>

#include "core/error.hpp"

namespace penumbra {

// Returns the folder that contains scenes/ and recordings/: $PENUMBRA_RESOURCES if it is set, else
// ../share/penumbra beside the program's folder (installed), else the nearest
// such folder above the program.
[[nodiscard]] Result<std::filesystem::path> find_resources();
// Like find_resources(), for a program at `program`. `given`: $PENUMBRA_RESOURCES, or nullptr.
[[nodiscard]] Result<std::filesystem::path> find_resources_of(const std::filesystem::path& program,
                                                              const char* given);

}  // namespace penumbra
