// Decodes JPEG images in memory.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "core/image/image_file.hpp"

namespace penumbra {

[[nodiscard]] bool is_jpeg(std::span<const std::uint8_t> bytes);

// Decodes a JPEG like decode_image(). Fails unless every block was decoded. Accepts bytes
// after the end marker, a missing end marker, a doubled start marker and a few bytes before a
// marker (core/image/jpeg_outline.hpp). The message about a damaged image ends with `remedy`.
[[nodiscard]] Result<Frame> decode_jpeg(std::span<const std::uint8_t> bytes,
                                        const std::string& name,
                                        std::string_view remedy = "record or copy it again");
[[nodiscard]] Result<RgbaImage> decode_jpeg_rgba(std::span<const std::uint8_t> bytes,
                                                 const std::string& name);

}  // namespace penumbra
