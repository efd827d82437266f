#include "app/window/pointer.hpp"

#include "render/gl/framebuffer.hpp"

namespace penumbra {
namespace {

// Returns the number of image pixels per window pixel.
double scale_of(const CameraModel& camera, const ImageArea& area) {
  return static_cast<double>(camera.width()) / area.width;
}

}  // namespace

Eigen::Vector2d window_from_image(const CameraModel& camera, GlContext::Size window,
                                  const Eigen::Vector2d& image_px) {
  const ImageArea area = image_area(camera.width(), camera.height(), window);
  return (image_px + Eigen::Vector2d::Constant(0.5)) / scale_of(camera, area) +
         Eigen::Vector2d(area.x, area.y);
}

std::optional<PointerView> pointer_in_window(const SessionView& view, GlContext::Size window,
                                             const Eigen::Vector2d& window_px) {
  if (view.camera == nullptr || !view.T_table_camera) return std::nullopt;
  const ImageArea area = image_area(view.camera->width(), view.camera->height(), window);
  const Eigen::Vector2d pixel =
      (window_px - Eigen::Vector2d(area.x, area.y)) * scale_of(*view.camera, area) -
      Eigen::Vector2d::Constant(0.5);
  return view_at(*view.camera, *view.T_table_camera, pixel);
}

}  // namespace penumbra
