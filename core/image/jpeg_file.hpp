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

// A JPEG is used if every one of its blocks was decoded, and not otherwise. What follows the end
// mark, a missing end mark, a doubled start mark, and a few bytes in front of markers are no damage
// (core/image/jpeg_outline.hpp).

[[nodiscard]] bool is_jpeg(std::span<const std::uint8_t> bytes);

// The planes, as decode_image() returns them. `remedy` ends the message about a damaged one.
[[nodiscard]] Result<Frame> decode_jpeg(std::span<const std::uint8_t> bytes,
                                        const std::string& name,
                                        std::string_view remedy = "record or copy it again");
[[nodiscard]] Result<RgbaImage> decode_jpeg_rgba(std::span<const std::uint8_t> bytes,
                                                 const std::string& name);

}  // namespace penumbra
