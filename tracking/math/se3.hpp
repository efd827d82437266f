// Exponential and logarithm of rigid motions.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

// Convert a twist [nu; omega] [m, rad] to its rigid motion and back.
[[nodiscard]] Eigen::Isometry3d exp_se3(const Vector6d& xi);
[[nodiscard]] Vector6d log_se3(const Eigen::Isometry3d& T);

// Returns the matrix with skew(v) * w = v x w.
[[nodiscard]] inline Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

}  // namespace penumbra
