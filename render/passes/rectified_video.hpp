// The video as a camera without a lens's distortion would have seen it: a grid, bent in the video,
// straight in the picture. Pixels of the video are resampled; what lies outside of it is black.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/image/frame.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/shader.hpp"
#include "render/passes/video_texture.hpp"

namespace penumbra {

// The same focal lengths and centre, no distortion: the middle of the picture stays as large as it
// is.
[[nodiscard]] CameraModel without_distortion(const CameraModel& camera);

// Corners of cells of 12 px, so small that between them places in the video are right to 0.1 px.
struct RectifyingGrid {
  int columns = 0, rows = 0;             // of corners
  std::vector<Eigen::Vector2d> picture;  // [px], row by row
  std::vector<Eigen::Vector2d> video;    // where they are there [px]; far outside where nowhere
};
[[nodiscard]] RectifyingGrid rectifying_grid(const CameraModel& camera);

class RectifiedVideo {
 public:
  RectifiedVideo(GlApi api, const CameraModel& camera);

  // The frame that was uploaded to `video`. Covers every pixel.
  [[nodiscard]] Result<void> draw(const VideoTexture& video, const Frame& frame);

 private:
  GlApi api_;
  int width_ = 0, height_ = 0;  // [px]
  VertexArray layout_;
  GlBuffer vertices_{BufferUse::vertices};
  GlBuffer indices_{BufferUse::indices};
  int index_count_ = 0;
  std::array<std::optional<ShaderProgram>, kVideoLayouts> programs_;
};

}  // namespace penumbra
