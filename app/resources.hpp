// Finds the program's own scenes, models and recordings.
#pragma once

#include <filesystem>

#include "core/error.hpp"

namespace penumbra {

// The folder with scenes/ and recordings/: $PENUMBRA_RESOURCES if it is set, else ../share/penumbra
// from the program's folder (installed), else the program's folder or one above it (a source tree).
[[nodiscard]] Result<std::filesystem::path> find_resources();
// The same for a program at `program`; `given` is the environment variable's value.
[[nodiscard]] Result<std::filesystem::path> find_resources_of(const std::filesystem::path& program,
                                                              const char* given);

}  // namespace penumbra
