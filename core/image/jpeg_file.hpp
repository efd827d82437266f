// JPEG images in memory.
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

// Returns the planes, as decode_image() does. Fails unless every block was decoded. Harmless are
// bytes after the end mark, a missing end mark, a doubled start mark, and a few bytes in front of
// markers (core/image/jpeg_outline.hpp). `remedy` ends the message about a damaged image.
[[nodiscard]] Result<Frame> decode_jpeg(std::span<const std::uint8_t> bytes,
                                        const std::string& name,
                                        std::string_view remedy = "record or copy it again");
[[nodiscard]] Result<RgbaImage> decode_jpeg_rgba(std::span<const std::uint8_t> bytes,
                                                 const std::string& name);

}  // namespace penumbra
