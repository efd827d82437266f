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
    : handle_(GlHandle<TextureTraits>::create()), filter_(filter) {
  glBindTexture(GL_TEXTURE_2D, handle_.id());
  const bool nearest = filter == TextureFilter::nearest;
  const bool trilinear = filter == TextureFilter::trilinear;
  const GLint wrap = trilinear ? GL_REPEAT : GL_CLAMP_TO_EDGE;
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, wrap);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, wrap);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, nearest ? GL_NEAREST : GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER,
                  nearest ? GL_NEAREST : (trilinear ? GL_LINEAR_MIPMAP_LINEAR : GL_LINEAR));
}

void Texture2d::upload(TexelFormat format, int width, int height, const std::uint8_t* data,
                       std::ptrdiff_t stride) {
  const GlFormat gl = gl_format(format);
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
  glBindTexture(GL_TEXTURE_2D, handle_.id());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glPixelStorei(GL_UNPACK_ROW_LENGTH, static_cast<GLint>(stride / texel));
  if (width == width_ && height == height_ && format == format_) {
    glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, width, height, gl.external, gl.type, data);
  } else {
    glTexImage2D(GL_TEXTURE_2D, 0, gl.internal, width, height, 0, gl.external, gl.type, data);
    width_ = width;
    height_ = height;
    format_ = format;
  }
  glPixelStorei(GL_UNPACK_ROW_LENGTH, 0);
  if (filter_ == TextureFilter::trilinear) glGenerateMipmap(GL_TEXTURE_2D);
}

void Texture2d::bind(int unit) const {
  glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
  glBindTexture(GL_TEXTURE_2D, handle_.id());
}

}  // namespace penumbra
