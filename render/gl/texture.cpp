#include "render/gl/texture.hpp"

#include <epoxy/gl.h>

#include <algorithm>

namespace penumbra {
namespace {

struct GlFormat {
  GLint internal;
  GLenum external;
  GLenum type = GL_UNSIGNED_BYTE;
};

GlFormat gl_format(TexelFormat format) {
  switch (format) {
    case TexelFormat::r8:
      return {GL_R8, GL_RED};
    case TexelFormat::rg8:
      return {GL_RG8, GL_RG};
    case TexelFormat::rgb8:
      return {GL_RGB8, GL_RGB};
    case TexelFormat::rgba8:
      return {GL_RGBA8, GL_RGBA};
    case TexelFormat::srgb8_alpha8:
      return {GL_SRGB8_ALPHA8, GL_RGBA};
    case TexelFormat::rgba16f:
      return {GL_RGBA16F, GL_RGBA, GL_HALF_FLOAT};
  }
  return {GL_R8, GL_RED};
}

GLint gl_wrap(TextureWrap wrap) {
  switch (wrap) {
    case TextureWrap::repeat:
      return GL_REPEAT;
    case TextureWrap::mirrored:
      return GL_MIRRORED_REPEAT;
    case TextureWrap::clamp:
      return GL_CLAMP_TO_EDGE;
  }
  return GL_REPEAT;
}

GLint gl_min_filter(const TextureSampling& sampling) {
  switch (sampling.mipmaps) {
    case TextureMipmaps::none:
      return sampling.smooth_far ? GL_LINEAR : GL_NEAREST;
    case TextureMipmaps::nearest:
      return sampling.smooth_far ? GL_LINEAR_MIPMAP_NEAREST : GL_NEAREST_MIPMAP_NEAREST;
    case TextureMipmaps::linear:
      return sampling.smooth_far ? GL_LINEAR_MIPMAP_LINEAR : GL_NEAREST_MIPMAP_LINEAR;
  }
  return GL_LINEAR_MIPMAP_LINEAR;
}

}  // namespace

int bytes_per_texel(TexelFormat format) {
  switch (format) {
    case TexelFormat::r8:
      return 1;
    case TexelFormat::rg8:
      return 2;
    case TexelFormat::rgb8:
      return 3;
    case TexelFormat::rgba8:
    case TexelFormat::srgb8_alpha8:
      return 4;
    case TexelFormat::rgba16f:
      return 8;
  }
  return 1;
}

Texture2d::Texture2d(TextureFilter filter)
    : Texture2d(TextureSampling{TextureWrap::clamp, TextureWrap::clamp,
                                filter == TextureFilter::linear, filter == TextureFilter::linear,
                                TextureMipmaps::none}) {}

Texture2d::Texture2d(const TextureSampling& sampling)
    : handle_(GlHandle<TextureTraits>::create()),
      mipmaps_(sampling.mipmaps != TextureMipmaps::none) {
  glBindTexture(GL_TEXTURE_2D, handle_.id());
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, gl_wrap(sampling.wrap_s));
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, gl_wrap(sampling.wrap_t));
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER,
                  sampling.smooth_near ? GL_LINEAR : GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, gl_min_filter(sampling));
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
  const GlFormat gl = gl_format(format);
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
