// Two-dimensional textures with 8-bit or half-float texels.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "render/gl/handle.hpp"
#include "render/gl/texture_sampling.hpp"

namespace penumbra {

enum class TexelFormat { r8, rg8, rgb8, rgba8, srgb8_alpha8, rgba16f };
[[nodiscard]] int bytes_per_texel(TexelFormat format);

// Filtering of a texture that is clamped to the edge and has no mipmaps.
enum class TextureFilter { nearest, linear };

class Texture2d {
 public:
  explicit Texture2d(TextureFilter filter);
  explicit Texture2d(const TextureSampling& sampling);

  // Uploads rows top to bottom, `stride` bytes apart; row 0 is at texture coordinate 0.
  void upload(TexelFormat format, int width, int height, const std::uint8_t* data,
              std::ptrdiff_t stride);
  // Uploads tightly packed rows from byte `offset` of the bound pixel unpack buffer.
  void upload_from_buffer(TexelFormat format, int width, int height, std::size_t offset);
  void bind(int unit) const;

 private:
  void put(TexelFormat format, int width, int height, const void* data, std::ptrdiff_t row_texels);
  TextureHandle handle_;
  bool mipmaps_ = false;
  TexelFormat format_ = TexelFormat::r8;
  int width_ = 0;
  int height_ = 0;
  std::vector<std::uint8_t> packed_;  // packed rows, if the stride is no multiple of a texel
};

}  // namespace penumbra
