// A hand-held camera whose rows are exposed one after another.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <optional>

#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"
#include "core/units.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra::test {

inline CameraModel with_row_time(const CameraModel& camera, std::optional<double> row_s) {
  CameraParameters p = camera.parameters();
  p.rolling_shutter_row_s = row_s;
  return CameraModel::make(p).value();
}

// Hand-held motion: pans of about 0.5 m/s in the table's plane at `speed` 1, about a view from 45
// degrees. `speed` 0: the camera turns about the table only slowly.
inline CameraPose panning_pose(double time_s, double speed) {
  const double a = speed * std::sin(5.1 * time_s);
  const double b = speed * std::sin(3.7 * time_s + 1.0);
  return looking_at({0.05 * a, 0.05 * b, 0.0}, 0.4 + 0.03 * b, radians(50.0 + 8.0 * a),
                    radians(40.0 * time_s + 10.0 * b), radians(8.0 * b));
}

// Returns where the panning camera shows a point if its middle row is exposed at `time_s`.
inline Eigen::Vector2d rolling_pixel(const CameraModel& camera, const Eigen::Vector3d& point,
                                     double time_s, double row_s, double speed) {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double row_time_s = time_s;
  for (int step = 0; step < 6; ++step) {
    pixel = camera.project(panning_pose(row_time_s, speed).inverse() * point)
                .value_or(Eigen::Vector2d::Zero());
    row_time_s = time_s + row_s * (pixel.y() - 0.5 * (camera.height() - 1));
  }
  return pixel;
}

}  // namespace penumbra::test
