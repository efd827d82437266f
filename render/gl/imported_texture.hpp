// Textures over another device's memory: a plane of a camera's DMA-BUF is read without a copy.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>

#include "render/gl/handle.hpp"
#include "render/gl/texture.hpp"

namespace penumbra {

// Returns true if the current context can import: an EGL context with EGL_EXT_image_dma_buf_import
// and GL_OES_EGL_image.
[[nodiscard]] bool can_import_textures();

struct ImportedPlane {
  int dma_buf = -1;
  TexelFormat format = TexelFormat::r8;  // r8, rg8, rgb8 or rgba8
  int width = 0, height = 0;             // [texels]
  std::size_t offset = 0;                // start of the first row in the buffer [bytes]
  std::ptrdiff_t stride = 0;             // [bytes]
};

// Samples the nearest texel. The caller must not return the buffer to the camera, which overwrites
// it, before the GPU has read it.
class ImportedTexture {
 public:
  // Returns nullopt if the driver rejects this layout. Requires can_import_textures(); that context
  // must be current now and at the destruction.
  [[nodiscard]] static std::optional<ImportedTexture> create(const ImportedPlane& plane);
  void bind(int unit) const;

 private:
  explicit ImportedTexture(void* image);

  // Declared before handle_: the texture must be destroyed before its image.
  std::unique_ptr<void, void (*)(void*)> image_;
  TextureHandle handle_;
};

}  // namespace penumbra
