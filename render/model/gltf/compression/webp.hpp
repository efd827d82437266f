// Decodes WebP images (EXT_texture_webp).
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "core/error.hpp"
#include "core/image/image_file.hpp"

namespace penumbra::gltf {

// Returns true if the bytes begin as a WebP file does.
[[nodiscard]] bool is_webp(std::span<const std::uint8_t> bytes);

// Decodes a still image within the size limits of decode_image(). `name`: as in errors.
[[nodiscard]] Result<RgbaImage> decode_webp(std::span<const std::uint8_t> bytes,
                                            const std::string& name);

}  // namespace penumbra::gltf
