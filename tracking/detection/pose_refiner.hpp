// Camera pose and its covariance by robust least squares on reprojection errors.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"
#include "tracking/detection/pose_solver.hpp"

namespace penumbra {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

// Diagonal covariance of a pose with these standard deviations [m, rad] per axis.
[[nodiscard]] inline Matrix6d covariance_of(double linear_m, double angular_rad) {
  Matrix6d covariance = Matrix6d::Zero();
  covariance.diagonal().head<3>().setConstant(linear_m * linear_m);
  covariance.diagonal().tail<3>().setConstant(angular_rad * angular_rad);
  return covariance;
}

// Rotation vector [rad] -> unit quaternion, and back.
[[nodiscard]] Eigen::Quaterniond exp_quaternion(const Eigen::Vector3d& omega);
[[nodiscard]] Eigen::Vector3d log_quaternion(const Eigen::Quaterniond& q);

// R exp(omega), t + R nu for xi = [nu; omega] (translation first, [m, rad], axes of From).
template <class To, class From>
[[nodiscard]] Transform<To, From> perturbed(const Transform<To, From>& T, const Vector6d& xi) {
  return {T.rotation() * exp_quaternion(xi.tail<3>()),
          T.translation() + T.rotation() * xi.head<3>()};
}
// The xi that leads from `from` to `to`.
template <class To, class From>
[[nodiscard]] Vector6d perturbation_between(const Transform<To, From>& from,
                                            const Transform<To, From>& to) {
  Vector6d xi;
  const Eigen::Quaterniond inverse = from.rotation().conjugate();
  xi.head<3>() = inverse * (to.translation() - from.translation());
  xi.tail<3>() = log_quaternion(inverse * to.rotation());
  return xi;
}

// d pixel / d xi at xi = 0, for a point of the map, which must be in front of the camera.
[[nodiscard]] Eigen::Matrix<double, 2, 6> reprojection_jacobian(const CameraModel& camera,
                                                                const MapFromCamera& T_map_camera,
                                                                const Eigen::Vector3d& p_map);

struct RefinerOptions {
  double robust_scale_px = 1.0;  // Huber: errors beyond count linearly
  // Least error of a corner [px] per axis: residuals don't show errors of lens model and tone
  // curve.
  double noise_floor_px = 0.15;
  int max_iterations = 50;
  // Uses ceres::Solve: the same to some thousandths of a pixel, at twenty times the cost.
  bool by_ceres = false;
};

struct RefinedPose {
  MapFromCamera T_map_camera;
  Matrix6d covariance = Matrix6d::Zero();  // of xi
  double rms_px = 0.0;                     // per corner (2-D distance), all observations
  double noise_px = 0.0;                   // per axis, as the covariance was scaled
};

// Levenberg-Marquardt. Nothing when a point is behind the start, the points do not fix the pose, or
// the minimum is not finite.
[[nodiscard]] std::optional<RefinedPose> refine_pose(const CameraModel& camera,
                                                     std::span<const PointObservation> observations,
                                                     const MapFromCamera& start,
                                                     const RefinerOptions& options = {});

}  // namespace penumbra
