// Where the program's own scenes, models and recordings are, whatever the current folder.
#pragma once

#include <filesystem>

#include "core/error.hpp"

namespace penumbra {

// A folder that holds scenes/ and recordings/, found in this order: $PENUMBRA_RESOURCES (when it is
// set it must be right), ../share/penumbra from the program's folder (installed), then the
// program's folder and those above it (a source tree: build/release/penumbra).
[[nodiscard]] Result<std::filesystem::path> find_resources();
// The same search for a program at `program`; `given` stands for the environment variable.
[[nodiscard]] Result<std::filesystem::path> find_resources_of(const std::filesystem::path& program,
                                                              const char* given);

}  // namespace penumbra
