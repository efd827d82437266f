#include "render/gl/imported_texture.hpp"

#include <epoxy/egl.h>
#include <epoxy/gl.h>

#include <array>
#include <cstdint>

namespace penumbra {
namespace {

// Returns a format code of drm_fourcc.h: four letters, the first in the lowest byte.
constexpr EGLint drm_format(const char (&letters)[5]) {
  std::uint32_t code = 0;
  for (std::size_t i = 4; i > 0; --i) {
    code = (code << 8U) | static_cast<std::uint8_t>(letters[i - 1]);
  }
  return static_cast<EGLint>(code);
}

// Returns the format with byte order red, green, blue, alpha; 0 if cameras don't use it.
EGLint drm_format_of(TexelFormat format) {
  switch (format) {
    case TexelFormat::r8:
      return drm_format("R8  ");
    case TexelFormat::rg8:
      return drm_format("GR88");
    case TexelFormat::rgb8:
      return drm_format("BG24");
    case TexelFormat::rgba8:
      return drm_format("AB24");
    case TexelFormat::srgb8_alpha8:
    case TexelFormat::rgba16f:
      break;
  }
  return 0;
}

}  // namespace

bool can_import_textures() {
  EGLDisplay display = eglGetCurrentDisplay();
  return display != EGL_NO_DISPLAY && eglGetCurrentContext() != EGL_NO_CONTEXT &&
         epoxy_has_egl_extension(display, "EGL_KHR_image_base") &&
         epoxy_has_egl_extension(display, "EGL_EXT_image_dma_buf_import") &&
         epoxy_has_gl_extension("GL_OES_EGL_image");
}

std::optional<ImportedTexture> ImportedTexture::create(const ImportedPlane& plane) {
  const EGLint format = drm_format_of(plane.format);
  if (format == 0) return std::nullopt;
  const std::array<EGLint, 13> attributes = {EGL_WIDTH,
                                             plane.width,
                                             EGL_HEIGHT,
                                             plane.height,
                                             EGL_LINUX_DRM_FOURCC_EXT,
                                             format,
                                             EGL_DMA_BUF_PLANE0_FD_EXT,
                                             plane.dma_buf,
                                             EGL_DMA_BUF_PLANE0_OFFSET_EXT,
                                             static_cast<EGLint>(plane.offset),
                                             EGL_DMA_BUF_PLANE0_PITCH_EXT,
                                             static_cast<EGLint>(plane.stride),
                                             EGL_NONE};
  EGLImageKHR image = eglCreateImageKHR(eglGetCurrentDisplay(), EGL_NO_CONTEXT,
                                        EGL_LINUX_DMA_BUF_EXT, nullptr, attributes.data());
  if (image == EGL_NO_IMAGE_KHR) return std::nullopt;
  ImportedTexture texture(image);
  while (glGetError() != GL_NO_ERROR) {
  }
  glBindTexture(GL_TEXTURE_2D, texture.handle_.id());
  glEGLImageTargetTexture2DOES(GL_TEXTURE_2D, image);
  // Some drivers accept the image but reject the texture.
  if (glGetError() != GL_NO_ERROR) return std::nullopt;
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  return texture;
}

ImportedTexture::ImportedTexture(void* image)
    : image_(image, [](void* of) { eglDestroyImageKHR(eglGetCurrentDisplay(), of); }),
      handle_(TextureHandle::create()) {}

void ImportedTexture::bind(int unit) const {
  glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
  glBindTexture(GL_TEXTURE_2D, handle_.id());
}

}  // namespace penumbra
