// Draws the video resampled: undistorted, or at another size than it was captured. It is a grid
// that is regular in the image and distorted in the video. The image is black outside the video.
#pragma once

#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/image/frame.hpp"
#include "render/passes/video_texture.hpp"

namespace penumbra {

// Returns a camera with the same focal lengths and centre but without distortion.
[[nodiscard]] CameraModel without_distortion(const CameraModel& camera);
// Returns a camera with the same view and another number of pixels.
[[nodiscard]] CameraModel with_size(const CameraModel& camera, int width, int height);

// Corners of cells of 12 px, so that interpolated video positions are accurate to 0.1 px.
struct RectifyingGrid {
  int columns = 0, rows = 0;              // numbers of corners
  std::vector<Eigen::Vector2d> image_px;  // [px], row by row
  std::vector<Eigen::Vector2d> video;     // video pixel of each corner; far outside if none
};
// `image_camera`: of the image that shows the video of `camera`.
[[nodiscard]] RectifyingGrid rectifying_grid(const CameraModel& camera,
                                             const CameraModel& image_camera);

class RectifiedVideo {
 public:
  // `camera`: the video's; `image_camera`: the image's.
  RectifiedVideo(GlApi api, const CameraModel& camera, const CameraModel& image_camera);

  // Draws the frame that was uploaded to `video`. Writes every pixel.
  [[nodiscard]] Result<void> draw(const VideoTexture& video, const Frame& frame);

 private:
  VideoProgram program_;
  int width_ = 0, height_ = 0;  // of the video [px]
  GlMesh grid_{2, 2};           // corners in NDC and in the video [px]
};

}  // namespace penumbra
