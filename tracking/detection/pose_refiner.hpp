// Camera pose by least squares on reprojection errors, with the full lens model and a robust loss,
// and what it is worth: its covariance.
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

// The pose moved by xi = [nu; omega] (translation first, [m, rad], in the camera's own axes):
// R exp(omega), t + R nu. To first order T exp(xi).
[[nodiscard]] CameraPose perturbed(const CameraPose& T_table_camera, const Vector6d& xi);
// The xi that leads from `from` to `to`.
[[nodiscard]] Vector6d perturbation_between(const CameraPose& from, const CameraPose& to);

// d pixel / d xi at xi = 0, for a point on the table; the point must be in front of the camera.
[[nodiscard]] Eigen::Matrix<double, 2, 6> reprojection_jacobian(const CameraModel& camera,
                                                                const CameraPose& T_table_camera,
                                                                const Eigen::Vector3d& p_table);

struct RefinerOptions {
  double robust_scale_px = 1.0;  // Huber: errors beyond count linearly
  // [px] per axis. Corners are never taken to be better than this: what is left of a lens model and
  // of tone mapping does not show in the residuals.
  double noise_floor_px = 0.15;
  int max_iterations = 50;
  // The minimum by ceres::Solve: the same to some thousandths of a pixel, at twenty times the cost.
  bool by_ceres = false;
};

struct RefinedPose {
  CameraPose T_table_camera;
  Matrix6d covariance = Matrix6d::Zero();  // of xi
  double rms_px = 0.0;                     // per corner (2-D distance), all observations
  double noise_px = 0.0;                   // per axis, as the covariance was scaled
};

// By Levenberg and Marquardt. Nothing when the start is not in front of every point, the points do
// not fix the pose, or the solver finds no finite minimum.
[[nodiscard]] std::optional<RefinedPose> refine_pose(const CameraModel& camera,
                                                     std::span<const PointObservation> observations,
                                                     const CameraPose& start,
                                                     const RefinerOptions& options = {});

}  // namespace penumbra
