// Estimates a camera pose and its covariance by robust least squares on reprojection errors.
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

// Returns the diagonal covariance of a pose with these standard deviations per axis [m, rad].
[[nodiscard]] inline Matrix6d covariance_of(double linear_m, double angular_rad) {
  Matrix6d covariance = Matrix6d::Zero();
  covariance.diagonal().head<3>().setConstant(linear_m * linear_m);
  covariance.diagonal().tail<3>().setConstant(angular_rad * angular_rad);
  return covariance;
}

// Convert a rotation vector [rad] to a unit quaternion and back.
[[nodiscard]] Eigen::Quaterniond exp_quaternion(const Eigen::Vector3d& omega);
[[nodiscard]] Eigen::Vector3d log_quaternion(const Eigen::Quaterniond& q);

// Returns (R exp(omega), t + R nu) for xi = [nu; omega] [m, rad], in the axes of From.
template <class To, class From>
[[nodiscard]] Transform<To, From> perturbed(const Transform<To, From>& T, const Vector6d& xi) {
  return {T.rotation() * exp_quaternion(xi.tail<3>()),
          T.translation() + T.rotation() * xi.head<3>()};
}
// Returns the xi for which perturbed(from, xi) is `to`.
template <class To, class From>
[[nodiscard]] Vector6d perturbation_between(const Transform<To, From>& from,
                                            const Transform<To, From>& to) {
  Vector6d xi;
  const Eigen::Quaterniond inverse = from.rotation().conjugate();
  xi.head<3>() = inverse * (to.translation() - from.translation());
  xi.tail<3>() = log_quaternion(inverse * to.rotation());
  return xi;
}

// Returns d pixel / d xi of perturbed(T_map_camera, xi); p_map must be in front of the camera.
[[nodiscard]] Eigen::Matrix<double, 2, 6> reprojection_jacobian(const CameraModel& camera,
                                                                const MapFromCamera& T_map_camera,
                                                                const Eigen::Vector3d& p_map);

// Minimum error of a corner per axis [px], because residuals don't include all errors of lens model
// and camera response.
inline constexpr double kCornerNoiseFloor_px = 0.15;

struct RefinerOptions {
  double robust_scale_px = 1.0;  // Huber: larger errors have linear loss
  int max_iterations = 50;
  // Uses ceres::Solve, which agrees within some 0.001 px and takes 20 times as long.
  bool by_ceres = false;
};

struct RefinedPose {
  MapFromCamera T_map_camera;
  Matrix6d covariance = Matrix6d::Zero();  // covariance of xi in perturbed(T_map_camera, xi)
  double rms_px = 0.0;                     // RMS distance from the observed pixels
  double noise_px = 0.0;                   // sigma per axis that scales the covariance
};

// Refines `start` by Levenberg-Marquardt. Returns nullopt if a point is behind the camera at
// `start`, the points do not determine the pose, or the minimum is not finite.
[[nodiscard]] std::optional<RefinedPose> refine_pose(const CameraModel& camera,
                                                     std::span<const PointObservation> observations,
                                                     const MapFromCamera& start,
                                                     const RefinerOptions& options = {});
// Refines each solution of solve_pose(). Returns the one that fits best, or nullopt if none does.
[[nodiscard]] std::optional<RefinedPose> find_pose(const CameraModel& camera,
                                                   std::span<const PointObservation> observations);

}  // namespace penumbra
