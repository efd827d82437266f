// Uploads video frames to the GPU and draws them 1:1 as the image's background.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string_view>
#include <utility>
#include <vector>

#include "core/image/frame.hpp"
#include "core/image/frame_identity.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/context.hpp"
#include "render/gl/imported_texture.hpp"
#include "render/gl/pixel_buffer.hpp"
#include "render/gl/shader.hpp"
#include "render/gl/texture.hpp"

namespace penumbra {

// Returns the define of video_texel.glsl for a pixel format.
[[nodiscard]] std::string_view layout_define(PixelFormat format);

// A program for each pixel format, linked on first use.
class VideoProgram {
 public:
  // `defines`: in addition to the format's.
  VideoProgram(GlApi api, ShaderFiles vertex, ShaderFiles fragment,
               std::vector<std::string_view> defines = {})
      : api_(api),
        vertex_(std::move(vertex)),
        fragment_(std::move(fragment)),
        defines_(std::move(defines)) {}
  [[nodiscard]] Result<const ShaderProgram*> get(PixelFormat format);

 private:
  GlApi api_;
  ShaderFiles vertex_, fragment_;
  std::vector<std::string_view> defines_;
  std::map<std::string_view, ShaderProgram> programs_;  // by layout_define()
};

class VideoTexture {
 public:
  // The context must be current, now and at every later call. `pixel_buffers`: copies use them.
  explicit VideoTexture(GlApi api, bool pixel_buffers = false)
      : program_(api, {"video.vert.glsl"}, {"video_texel.glsl", "video.frag.glsl"},
                 {"WHOLE_PICTURE"}),
        pixel_buffers_(pixel_buffers),
        can_import_(can_import_textures()) {}
  VideoTexture(VideoTexture&&) noexcept = default;
  VideoTexture& operator=(VideoTexture&&) noexcept = default;
  VideoTexture(const VideoTexture&) = delete;
  VideoTexture& operator=(const VideoTexture&) = delete;
  ~VideoTexture();

  enum class Upload {
    there,     // the frame was on the GPU already
    copied,    // plane by plane
    buffered,  // through a pixel buffer, without waiting for the previous frame
    imported   // read in place from the camera driver's shared buffer
  };
  // Makes the frame's planes available to the GPU. If `reuse`, does not upload a frame again.
  Upload upload(const Frame& frame, bool reuse = true);
  // Writes every pixel, so the colour needs no clearing.
  [[nodiscard]] Result<void> draw(const Frame& frame);
  // Binds the uploaded frame to this texture unit and the next two. The current program must
  // contain video_texel.glsl.
  void bind_texels(const ShaderProgram& program, const Frame& frame, int first_unit) const;
  // Must be called after the last draw call that reads the frame. An imported buffer returns to the
  // camera when the GPU has executed these calls.
  void hold(const Frame& frame);
  // Waits for the GPU and returns all imported buffers to the camera. For frames that the CPU
  // converts.
  void release_all();

 private:
  // One of the camera's buffers, as textures.
  struct ImportedBuffer {
    std::uint64_t number = 0;
    std::vector<ImportedTexture> planes;
  };
  // A frame whose buffer the GPU may still be reading.
  struct InUse {
    std::shared_ptr<const void> owner;
    void* drawn = nullptr;  // a fence after the draw calls that read it
  };

  [[nodiscard]] bool import(const Frame& frame);
  // Returns false if the driver provides no buffer or loses it.
  [[nodiscard]] bool upload_through_buffer(const Frame& frame);
  // Releases frames that the GPU has finished; waits while more than `max_in_use` are in use.
  void release(std::size_t max_in_use);

  VideoProgram program_;
  bool pixel_buffers_ = false;
  UploadBuffers buffers_;
  VertexArray no_vertices_;
  std::vector<Texture2d> textures_;
  FrameIdentity uploaded_;
  bool can_import_ = false;
  std::deque<ImportedBuffer> imported_;  // the most recently used is last
  bool shows_imported_ = false;          // the frame is imported_.back(), not textures_
  std::deque<InUse> in_use_;             // in drawing order
};

}  // namespace penumbra
