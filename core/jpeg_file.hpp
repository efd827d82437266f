// JPEG images in memory.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "core/error.hpp"
#include "core/frame.hpp"
#include "core/image_file.hpp"

namespace penumbra {

// The planes of a JPEG, as decode_image() returns them.
[[nodiscard]] Result<Frame> decode_jpeg(std::span<const std::uint8_t> bytes,
                                        const std::string& name);
[[nodiscard]] Result<RgbaImage> decode_jpeg_rgba(std::span<const std::uint8_t> bytes,
                                                 const std::string& name);

}  // namespace penumbra
