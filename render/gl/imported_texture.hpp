// Textures whose memory is somebody else's: a plane in a camera's buffer (DMA-BUF), read by the GPU
// where it lies, with no copy.
#pragma once

#include <cstddef>
#include <optional>

#include "render/gl/handle.hpp"
#include "render/gl/texture.hpp"

namespace penumbra {

// Whether the context that is current on this thread can have any: it is EGL's, and its driver has
// EGL_EXT_image_dma_buf_import and GL_OES_EGL_image.
[[nodiscard]] bool can_import_textures();

struct ImportedPlane {
  int dma_buf = -1;
  TexelFormat format = TexelFormat::r8;  // r8, rg8, rgb8 or rgba8
  int width = 0, height = 0;             // [texels]
  std::size_t offset = 0;                // of the first row [bytes]
  std::ptrdiff_t stride = 0;             // [bytes]
};

// Fetched texel by texel. What is in the memory changes as the camera writes it: whoever draws
// keeps the buffer until the GPU is done.
class ImportedTexture {
 public:
  // Nothing where the driver does not take memory of this layout. Only where can_import_textures();
  // that context is current now, and when this is destroyed.
  [[nodiscard]] static std::optional<ImportedTexture> create(const ImportedPlane& plane);
  ImportedTexture(ImportedTexture&& other) noexcept;
  ImportedTexture& operator=(ImportedTexture&& other) noexcept;
  ImportedTexture(const ImportedTexture&) = delete;
  ImportedTexture& operator=(const ImportedTexture&) = delete;
  ~ImportedTexture();

  void bind(int unit) const;

 private:
  explicit ImportedTexture(void* image);

  void* image_ = nullptr;  // EGL's
  GlHandle<TextureTraits> handle_;
};

}  // namespace penumbra
