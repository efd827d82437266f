// A folder of 000000.png, 000001.png, ... numbered by frame, and nothing else.
#pragma once

#include "app/output/frame_writer.hpp"

namespace penumbra {

// Pictures go to a folder of this run's own beside it, which finish() renames. A folder that is
// there already is replaced if it holds nothing but such pictures; one that holds anything else, or
// belongs to a recording, is refused.
[[nodiscard]] Result<std::unique_ptr<FrameWriter>> create_png_writer(
    const std::filesystem::path& folder, const FrameFormat& format);

}  // namespace penumbra
