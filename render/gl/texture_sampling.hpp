// Filtering and wrapping of textures.
#pragma once

namespace penumbra {

enum class TextureWrap { repeat, mirrored, clamp };
enum class TextureMipmaps { none, nearest, linear };

struct TextureSampling {
  TextureWrap wrap_s = TextureWrap::repeat;
  TextureWrap wrap_t = TextureWrap::repeat;
  bool smooth_near = true;  // magnified: linear, or nearest
  bool smooth_far = true;   // minified: linear, or nearest, within a mipmap level
  TextureMipmaps mipmaps = TextureMipmaps::linear;

  friend auto operator<=>(const TextureSampling&, const TextureSampling&) = default;
};

}  // namespace penumbra
