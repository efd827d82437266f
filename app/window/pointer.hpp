// From a place in the window to what is there: window pixels, whose first corner is (0, 0), and the
// picture's pixels, whose first centre is (0, 0).
#pragma once

#include <Eigen/Core>
#include <optional>

#include "app/session/session.hpp"
#include "app/window/manipulation.hpp"
#include "core/camera/camera_model.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

[[nodiscard]] Eigen::Vector2d picture_from_window(const CameraModel& camera, GlContext::Size window,
                                                  const Eigen::Vector2d& window_px);
[[nodiscard]] Eigen::Vector2d window_from_picture(const CameraModel& camera, GlContext::Size window,
                                                  const Eigen::Vector2d& picture_px);
// Nothing outside of the picture, or without a pose.
[[nodiscard]] std::optional<PointerView> pointer_in_window(const SessionView& view,
                                                           GlContext::Size window,
                                                           const Eigen::Vector2d& window_px);

}  // namespace penumbra
