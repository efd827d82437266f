#include "render/passes/rectified_video.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <glm/vec2.hpp>

#include "core/assert.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr double kCell_px = 12.0;
constexpr double kNowhere_px = -1e6;

}  // namespace

CameraModel without_distortion(const CameraModel& camera) {
  CameraParameters p = camera.parameters();
  p.model = DistortionModel::plumb_bob;
  p.distortion = {};
  auto straight = CameraModel::make(p);
  PENUMBRA_ASSERT(straight.has_value());
  return std::move(*straight);
}

CameraModel with_size(const CameraModel& camera, int width, int height) {
  CameraParameters p = camera.parameters();
  const double across = static_cast<double>(width) / p.width;
  const double down = static_cast<double>(height) / p.height;
  p.width = width;
  p.height = height;
  p.fx *= across;
  p.fy *= down;
  p.cx = across * (p.cx + 0.5) - 0.5;
  p.cy = down * (p.cy + 0.5) - 0.5;
  p.rolling_shutter_row_s.reset();  // more rows would take longer than a camera may
  auto sized = CameraModel::make(p);
  PENUMBRA_ASSERT(sized.has_value());
  return std::move(*sized);
}

RectifyingGrid rectifying_grid(const CameraModel& camera, const CameraModel& image_camera) {
  // An image with the video's distortion is only scaled.
  const bool straightens = camera.has_distortion() && !image_camera.has_distortion();
  const double across = static_cast<double>(camera.width()) / image_camera.width();
  const double down = static_cast<double>(camera.height()) / image_camera.height();
  RectifyingGrid grid;
  grid.columns = static_cast<int>(std::ceil(image_camera.width() / kCell_px)) + 1;
  grid.rows = static_cast<int>(std::ceil(image_camera.height() / kCell_px)) + 1;
  for (int row = 0; row < grid.rows; ++row) {
    for (int column = 0; column < grid.columns; ++column) {
      // Covers the image from edge to edge.
      const Eigen::Vector2d pixel(-0.5 + std::min(column * kCell_px, 1.0 * image_camera.width()),
                                  -0.5 + std::min(row * kCell_px, 1.0 * image_camera.height()));
      grid.image_px.push_back(pixel);
      if (!straightens) {
        grid.video.emplace_back(across * (pixel.x() + 0.5) - 0.5, down * (pixel.y() + 0.5) - 0.5);
        continue;
      }
      const auto ray = image_camera.unproject(pixel);
      const auto source = ray ? camera.project_extended(*ray) : std::nullopt;
      grid.video.push_back(source ? *source : Eigen::Vector2d::Constant(kNowhere_px));
    }
  }
  return grid;
}

RectifiedVideo::RectifiedVideo(GlApi api, const CameraModel& camera,
                               const CameraModel& image_camera)
    : program_(api, {"rectified.vert.glsl"}, {"video_texel.glsl", "rectified.frag.glsl"}),
      width_(camera.width()),
      height_(camera.height()) {
  const RectifyingGrid grid = rectifying_grid(camera, image_camera);
  std::vector<glm::vec4> corners;
  for (std::size_t i = 0; i < grid.image_px.size(); ++i) {
    const Eigen::Vector2d& p = grid.image_px[i];
    const Eigen::Vector2d& v = grid.video[i];
    corners.emplace_back(static_cast<float>(2.0 * (p.x() + 0.5) / image_camera.width() - 1.0),
                         static_cast<float>(2.0 * (p.y() + 0.5) / image_camera.height() - 1.0),
                         static_cast<float>(v.x()), static_cast<float>(v.y()));
  }
  std::vector<std::uint32_t> indices;
  const auto columns = static_cast<std::uint32_t>(grid.columns);
  for (std::uint32_t row = 0; row + 1 < static_cast<std::uint32_t>(grid.rows); ++row) {
    for (std::uint32_t column = 0; column + 1 < columns; ++column) {
      for (const std::uint32_t i : cell_indices(row * columns + column, columns))
        indices.push_back(i);
    }
  }
  grid_.write(corners);
  grid_.write_indices(indices);
}

Result<void> RectifiedVideo::draw(const VideoTexture& video, const Frame& frame) {
  PENUMBRA_TRY(const auto program, program_.get(frame.format));
  program->use();
  video.bind_texels(*program, frame, 0);
  program->set("last_pixel", glm::vec2(width_ - 1, height_ - 1));
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  glDepthMask(GL_FALSE);
  grid_.draw(GL_TRIANGLES);
  return {};
}

}  // namespace penumbra
