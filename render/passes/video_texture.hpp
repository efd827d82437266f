// The captured video frame on the GPU, and the image's background drawn from it, 1:1.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string_view>
#include <vector>

#include "core/image/frame.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/context.hpp"
#include "render/gl/imported_texture.hpp"
#include "render/gl/pixel_buffer.hpp"
#include "render/gl/shader.hpp"
#include "render/gl/texture.hpp"
#include "render/scene/yuv_conversion.hpp"

namespace penumbra {

// A program for each layout of texels; formats with the same one share it.
inline constexpr std::size_t kVideoLayouts = 5;
[[nodiscard]] std::size_t layout_number(PixelFormat format);
// What video_texel.glsl wants defined for it.
[[nodiscard]] std::string_view layout_define(PixelFormat format);

class VideoTexture {
 public:
  // The context is current, now and at every later call. `pixel_buffers`: planes are copied through
  // them.
  explicit VideoTexture(GlApi api, bool pixel_buffers = false)
      : api_(api), pixel_buffers_(pixel_buffers), can_import_(can_import_textures()) {}
  VideoTexture(VideoTexture&&) noexcept = default;
  VideoTexture& operator=(VideoTexture&&) noexcept = default;
  VideoTexture(const VideoTexture&) = delete;
  VideoTexture& operator=(const VideoTexture&) = delete;
  ~VideoTexture();

  enum class Way {
    there,     // it was on the GPU already
    copied,    // plane by plane
    buffered,  // the same through a pixel buffer, without waiting for the frame before
    imported   // read where it lies, in a buffer that the camera's driver shares
  };
  // Makes the frame's planes available to the GPU. A frame that is there already is uploaded again
  // only where `reuse` is false.
  Way upload(const Frame& frame, bool reuse = true);
  // Covers every pixel: no clearing of colour is needed.
  [[nodiscard]] Result<void> draw(const Frame& frame);
  // Binds the uploaded frame for a program in use that contains video_texel.glsl, to this texture
  // unit and the two behind it.
  void bind_texels(const ShaderProgram& program, const Frame& frame, int first_unit) const;
  // To be called after the last read of the frame: a buffer that the GPU reads in place returns to
  // the camera only when the GPU has reached this point.
  void hold(const Frame& frame);

 private:
  // A buffer that the camera fills again and again, as textures.
  struct ImportedBuffer {
    std::uint64_t number = 0;
    std::vector<ImportedTexture> planes;
  };
  // A frame that the GPU may still be reading: its buffer must not return to the camera.
  struct InUse {
    std::shared_ptr<const void> owner;
    void* drawn = nullptr;  // a fence behind what reads it
  };

  [[nodiscard]] Result<const ShaderProgram*> program_for(PixelFormat format);
  [[nodiscard]] bool import(const Frame& frame);
  // False where the driver gives no buffer, or loses it.
  [[nodiscard]] bool upload_through_buffer(const Frame& frame);
  // Releases frames that the GPU has finished; waits for it where more than `most` are in use.
  void release(std::size_t most);

  GlApi api_;
  bool pixel_buffers_ = false;
  UploadBuffers buffers_;
  VertexArray no_vertices_;
  std::vector<Texture2d> textures_;
  std::array<std::optional<ShaderProgram>, kVideoLayouts> programs_;
  std::weak_ptr<const void> uploaded_owner_;
  const std::uint8_t* uploaded_data_ = nullptr;
  bool can_import_ = false;
  std::deque<ImportedBuffer> imported_;  // the one that was used last at the end
  bool shows_imported_ = false;          // that one is the picture, and not textures_
  std::deque<InUse> in_use_;             // in the order in which they were drawn
};

}  // namespace penumbra
