// Converts between window pixels (corner of the first pixel at (0, 0)) and image pixels (centre of
// the first pixel at (0, 0)).
#pragma once

#include <Eigen/Core>
#include <optional>

#include "app/session/session.hpp"
#include "app/window/manipulation.hpp"
#include "core/camera/camera_model.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

[[nodiscard]] Eigen::Vector2d window_from_image(const CameraModel& camera, GlContext::Size window,
                                                const Eigen::Vector2d& image_px);
// Returns nullopt without a pose, or if the lens has no ray for the pixel.
[[nodiscard]] std::optional<PointerView> pointer_in_window(const SessionView& view,
                                                           GlContext::Size window,
                                                           const Eigen::Vector2d& window_px);

}  // namespace penumbra
