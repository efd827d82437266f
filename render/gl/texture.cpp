#include "render/gl/texture.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>

namespace penumbra {
namespace {

struct TexelLayout {
  GLint internal;
  GLenum external, type;
  int bytes;
};
TexelLayout layout_of(TexelFormat format) {
  switch (format) {
    case TexelFormat::r8:
      return {GL_R8, GL_RED, GL_UNSIGNED_BYTE, 1};
    case TexelFormat::rg8:
      return {GL_RG8, GL_RG, GL_UNSIGNED_BYTE, 2};
    case TexelFormat::rgb8:
      return {GL_RGB8, GL_RGB, GL_UNSIGNED_BYTE, 3};
    case TexelFormat::rgba8:
      return {GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE, 4};
    case TexelFormat::srgb8_alpha8:
      return {GL_SRGB8_ALPHA8, GL_RGBA, GL_UNSIGNED_BYTE, 4};
    case TexelFormat::rgba16f:
      return {GL_RGBA16F, GL_RGBA, GL_HALF_FLOAT, 8};
  }
  return {};
}

// Indexed by TextureWrap.
constexpr std::array<GLint, 3> kWraps = {GL_REPEAT, GL_MIRRORED_REPEAT, GL_CLAMP_TO_EDGE};
static_assert(kWraps.size() == static_cast<std::size_t>(TextureWrap::clamp) + 1);
// Indexed by linear (0 or 1) and by TextureMipmaps.
constexpr std::array<std::array<GLint, 3>, 2> kMinFilters = {
    {{GL_NEAREST, GL_NEAREST_MIPMAP_NEAREST, GL_NEAREST_MIPMAP_LINEAR},
     {GL_LINEAR, GL_LINEAR_MIPMAP_NEAREST, GL_LINEAR_MIPMAP_LINEAR}}};
static_assert(kMinFilters[0].size() == static_cast<std::size_t>(TextureMipmaps::linear) + 1);

GLint gl_wrap(TextureWrap wrap) {
  return kWraps[static_cast<std::size_t>(wrap)];
}

}  // namespace

int bytes_per_texel(TexelFormat format) {
  return layout_of(format).bytes;
}

Texture2d::Texture2d(TextureFilter filter)
    : Texture2d(TextureSampling{TextureWrap::clamp, TextureWrap::clamp,
                                filter == TextureFilter::linear, filter == TextureFilter::linear,
                                TextureMipmaps::none}) {}

Texture2d::Texture2d(const TextureSampling& sampling)
    : handle_(TextureHandle::create()), mipmaps_(sampling.mipmaps != TextureMipmaps::none) {
  glBindTexture(GL_TEXTURE_2D, handle_.id());
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, gl_wrap(sampling.wrap_s));
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, gl_wrap(sampling.wrap_t));
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER,
                  sampling.smooth_near ? GL_LINEAR : GL_NEAREST);
  glTexParameteri(
      GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER,
      kMinFilters[sampling.smooth_far ? 1 : 0][static_cast<std::size_t>(sampling.mipmaps)]);
}

void Texture2d::upload(TexelFormat format, int width, int height, const std::uint8_t* data,
                       std::ptrdiff_t stride) {
  const int texel = bytes_per_texel(format);
  if (stride % texel != 0) {
    const auto row_bytes = static_cast<std::size_t>(width) * static_cast<std::size_t>(texel);
    packed_.resize(row_bytes * static_cast<std::size_t>(height));
    for (int y = 0; y < height; ++y) {
      std::copy_n(data + y * stride, row_bytes,
                  packed_.data() + static_cast<std::size_t>(y) * row_bytes);
    }
    data = packed_.data();
    stride = static_cast<std::ptrdiff_t>(row_bytes);
  }
  put(format, width, height, data, stride / texel);
}

void Texture2d::upload_from_buffer(TexelFormat format, int width, int height, std::size_t offset) {
  put(format, width, height, reinterpret_cast<const void*>(offset), width);
}

void Texture2d::put(TexelFormat format, int width, int height, const void* data,
                    std::ptrdiff_t row_texels) {
  const TexelLayout& gl = layout_of(format);
  glBindTexture(GL_TEXTURE_2D, handle_.id());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glPixelStorei(GL_UNPACK_ROW_LENGTH, static_cast<GLint>(row_texels));
  if (width == width_ && height == height_ && format == format_) {
    glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, width, height, gl.external, gl.type, data);
  } else {
    glTexImage2D(GL_TEXTURE_2D, 0, gl.internal, width, height, 0, gl.external, gl.type, data);
    width_ = width;
    height_ = height;
    format_ = format;
  }
  glPixelStorei(GL_UNPACK_ROW_LENGTH, 0);
  if (mipmaps_) glGenerateMipmap(GL_TEXTURE_2D);
}

void Texture2d::bind(int unit) const {
  glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
  glBindTexture(GL_TEXTURE_2D, handle_.id());
}

}  // namespace penumbra
