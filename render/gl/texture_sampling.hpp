// How a texture is looked up between and beyond its texels.
#pragma once

namespace penumbra {

enum class TextureWrap { repeat, mirrored, clamp };
enum class TextureMipmaps { none, nearest, linear };

struct TextureSampling {
  TextureWrap wrap_s = TextureWrap::repeat;
  TextureWrap wrap_t = TextureWrap::repeat;
  bool smooth_near = true;  // magnified: between texels, or the nearest
  bool smooth_far = true;   // minified, within a mipmap
  TextureMipmaps mipmaps = TextureMipmaps::linear;

  friend auto operator<=>(const TextureSampling&, const TextureSampling&) = default;
};

}  // namespace penumbra
