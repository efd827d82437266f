// Conversions between window pixels, whose first corner is (0, 0), and image pixels, whose first
// centre is (0, 0).
#pragma once

#include <Eigen/Core>
#include <optional>

#include "app/session/session.hpp"
#include "app/window/manipulation.hpp"
#include "core/camera/camera_model.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

[[nodiscard]] Eigen::Vector2d window_from_picture(const CameraModel& camera, GlContext::Size window,
                                                  const Eigen::Vector2d& picture_px);
// Empty outside of the image, or without a pose.
[[nodiscard]] std::optional<PointerView> pointer_in_window(const SessionView& view,
                                                           GlContext::Size window,
                                                           const Eigen::Vector2d& window_px);

}  // namespace penumbra
