// The folder of a new recording.
#pragma once

#include <filesystem>

#include "app/output/output_file.hpp"
#include "core/error.hpp"

namespace penumbra {

// Creates the partial folder of a recording. Fails if `path` exists and is not an empty folder.
[[nodiscard]] Result<void> create_recording_folder(const std::filesystem::path& path,
                                                   OutputFolder& folder);

}  // namespace penumbra
