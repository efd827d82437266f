#include "tracking/detection/pose_refiner.hpp"

#include <ceres/ceres.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <limits>
#include <tuple>

namespace penumbra {
namespace {

constexpr double kMinDepth_m = 1e-6;  // minimum z of a point in the camera frame [m]

// T_map_camera as a parameter block: qx qy qz qw tx ty tz.
using PoseParameters = std::array<double, 7>;

MapFromCamera to_pose(const double* x) {
  return {Eigen::Quaterniond(x[3], x[0], x[1], x[2]), Eigen::Vector3d(x[4], x[5], x[6])};
}

void write_pose(const MapFromCamera& pose, double* x) {
  Eigen::Map<Eigen::Vector4d>(x + 0) = pose.rotation().coeffs();
  Eigen::Map<Eigen::Vector3d>(x + 4) = pose.translation();
}

// Unit quaternions x R^3 with steps in the camera's axes. Costs write d residual / d step into the
// first 6 of the 7 columns of their Jacobian, and PlusJacobian() selects these. Ceres uses a cost's
// Jacobian only in its product with PlusJacobian().
class PoseManifold final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return 7; }
  int TangentSize() const override { return 6; }
  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override {
    write_pose(perturbed(to_pose(x), Eigen::Map<const Vector6d>(delta)), x_plus_delta);
    return true;
  }
  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, 7, 6, Eigen::RowMajor>>(jacobian).setIdentity();
    return true;
  }
  bool Minus(const double* y, const double* x, double* y_minus_x) const override {
    Eigen::Map<Vector6d>{y_minus_x} = perturbation_between(to_pose(x), to_pose(y));
    return true;
  }
  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, 6, 7, Eigen::RowMajor>>(jacobian).setIdentity();
    return true;
  }
};

class ReprojectionCost final : public ceres::SizedCostFunction<2, 7> {
 public:
  ReprojectionCost(const CameraModel& camera, const PointObservation& observation)
      : camera_(camera), observation_(observation) {}

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const MapFromCamera pose = to_pose(parameters[0]);
    const Eigen::Vector3d p = pose.inverse() * observation_.p_map;
    if (!(p.z() > kMinDepth_m)) return false;  // Ceres takes a shorter step
    Eigen::Map<Eigen::Vector2d> residual(residuals);
    residual = camera_.project_unchecked(p) - observation_.pixel;
    if (jacobians != nullptr && jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 2, 7, Eigen::RowMajor>> J(jacobians[0]);
      J.leftCols<6>() = reprojection_jacobian(camera_, pose, observation_.p_map);
      J.col(6).setZero();
    }
    return residual.allFinite();
  }

 private:
  const CameraModel& camera_;
  const PointObservation& observation_;
};

std::optional<MapFromCamera> minimum_by_ceres(const CameraModel& camera,
                                              std::span<const PointObservation> observations,
                                              const MapFromCamera& start,
                                              const RefinerOptions& options) {
  PoseParameters x{};
  write_pose(start, x.data());
  ceres::Problem::Options ownership;
  ownership.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ownership.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ownership.disable_all_safety_checks = true;
  // Declared before `problem`, which refers to them and must be destroyed first.
  ceres::HuberLoss loss(options.robust_scale_px);
  PoseManifold manifold;
  std::deque<ReprojectionCost> costs;  // a deque keeps addresses valid
  ceres::Problem problem(ownership);
  problem.AddParameterBlock(x.data(), 7, &manifold);
  for (const PointObservation& observation : observations) {
    costs.emplace_back(camera, observation);
    problem.AddResidualBlock(&costs.back(), &loss, x.data());
  }
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_QR;
  solver.max_num_iterations = options.max_iterations;
  solver.num_threads = 1;
  solver.logging_type = ceres::SILENT;
  // With these tolerances, the final step moves every corner by less than 1e-4 px.
  solver.function_tolerance = 1e-10;
  solver.parameter_tolerance = 1e-10;
  solver.gradient_tolerance = 1e-12;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  if (!summary.IsSolutionUsable()) return std::nullopt;
  return to_pose(x.data());
}

// Normal equations of a step in the camera's axes.
struct NormalEquations {
  Matrix6d H = Matrix6d::Zero();  // lower triangle
  Vector6d g = Vector6d::Zero();
};
// Returns the Huber cost (infinite if a point is behind the camera) and adds the normal equations.
double cost_of(const CameraModel& camera, std::span<const PointObservation> observations,
               const MapFromCamera& pose, double robust_scale_px, NormalEquations& equations) {
  const auto T_camera_map = pose.inverse();
  const Eigen::Matrix3d R = T_camera_map.rotation_matrix();
  const Eigen::Vector3d& t = T_camera_map.translation();
  double cost = 0.0;
  Eigen::Matrix<double, 2, 3> J_point;
  for (const PointObservation& observation : observations) {
    const Eigen::Vector3d p = R * observation.p_map + t;
    if (!(p.z() > kMinDepth_m)) return std::numeric_limits<double>::infinity();
    const Eigen::Vector2d r = camera.project_unchecked(p, &J_point) - observation.pixel;
    const double square = r.squaredNorm();
    const bool inside = square <= robust_scale_px * robust_scale_px;
    const double error = inside ? 0.0 : std::sqrt(square);
    cost += inside ? square : robust_scale_px * (2.0 * error - robust_scale_px);
    const double weight = inside ? 1.0 : robust_scale_px / error;
    // A step of the camera moves the point to p - nu - omega x p = p - nu + [p]x omega.
    std::array<std::array<double, 6>, 2> J;
    for (int axis = 0; axis < 2; ++axis) {
      const double x = J_point(axis, 0);
      const double y = J_point(axis, 1);
      const double z = J_point(axis, 2);
      J[static_cast<std::size_t>(axis)] = {
          -x, -y, -z, y * p.z() - z * p.y(), z * p.x() - x * p.z(), x * p.y() - y * p.x()};
    }
    for (std::size_t row = 0; row < 6; ++row) {
      const double w0 = weight * J[0][row];
      const double w1 = weight * J[1][row];
      for (std::size_t column = 0; column <= row; ++column)
        equations.H(static_cast<int>(row), static_cast<int>(column)) +=
            w0 * J[0][column] + w1 * J[1][column];
      equations.g[static_cast<int>(row)] += w0 * r[0] + w1 * r[1];
    }
  }
  return cost;
}

// Levenberg-Marquardt with Huber's weights of the current pose. Every point must be in front of the
// camera at the start.
std::optional<MapFromCamera> minimum_near(const CameraModel& camera,
                                          std::span<const PointObservation> observations,
                                          const MapFromCamera& start,
                                          const RefinerOptions& options) {
  // The iteration ends after a step that moves the points by less than this [px, RMS].
  constexpr double kLastStep_px = 1e-7;
  const double last_step2 = kLastStep_px * kLastStep_px * static_cast<double>(observations.size());
  MapFromCamera pose = start;
  NormalEquations equations;
  double cost = cost_of(camera, observations, pose, options.robust_scale_px, equations);
  if (!std::isfinite(cost)) return std::nullopt;
  double damping = 1e-4;
  double damping_factor = 2.0;
  for (int i = 0; i < options.max_iterations; ++i) {
    Matrix6d damped = equations.H;
    damped.diagonal() += damping * equations.H.diagonal().cwiseMax(1e-6).cwiseMin(1e32);
    const Vector6d step = damped.ldlt().solve(-equations.g);
    if (!step.allFinite()) return std::nullopt;
    const double moved2 = step.dot(equations.H.selfadjointView<Eigen::Lower>() * step);
    const MapFromCamera next = perturbed(pose, step);
    NormalEquations next_equations;
    const double next_cost =
        cost_of(camera, observations, next, options.robust_scale_px, next_equations);
    if (next_cost <= cost) {
      pose = next;
      cost = next_cost;
      equations = next_equations;
      damping = std::max(damping / 3.0, 1e-16);
      damping_factor = 2.0;
    } else {
      damping *= damping_factor;
      damping_factor *= 2.0;
    }
    // A short step that is rejected also ends the iteration: only rounding errors remain.
    if (moved2 <= last_step2 || !(damping < 1e32)) break;
  }
  return pose;
}

}  // namespace

Eigen::Quaterniond exp_quaternion(const Eigen::Vector3d& omega) {
  const double half = 0.5 * omega.norm();
  // sin(half) / |omega|, or its series near 0 / 0
  const double scale = half < 1e-6 ? 0.5 - half * half / 12.0 : 0.5 * std::sin(half) / half;
  return {std::cos(half), scale * omega.x(), scale * omega.y(), scale * omega.z()};
}

Eigen::Vector3d log_quaternion(const Eigen::Quaterniond& q) {
  const double sign = q.w() < 0.0 ? -1.0 : 1.0;  // selects the shorter rotation
  const double s = q.vec().norm();
  const double angle = 2.0 * std::atan2(s, sign * q.w());
  return s < 1e-12 ? Eigen::Vector3d(2.0 * sign * q.vec())
                   : Eigen::Vector3d(sign * angle / s * q.vec());
}

Eigen::Matrix<double, 2, 6> reprojection_jacobian(const CameraModel& camera,
                                                  const MapFromCamera& T_map_camera,
                                                  const Eigen::Vector3d& p_map) {
  const Eigen::Vector3d p = T_map_camera.inverse() * p_map;
  Eigen::Matrix<double, 2, 3> J_point;
  std::ignore = camera.project_unchecked(p, &J_point);
  // A step of the camera moves the point to p - nu - omega x p = p - nu + [p]x omega.
  Eigen::Matrix<double, 3, 6> J_step;
  J_step << -1.0, 0.0, 0.0, 0.0, -p.z(), p.y(),  //
      0.0, -1.0, 0.0, p.z(), 0.0, -p.x(),        //
      0.0, 0.0, -1.0, -p.y(), p.x(), 0.0;
  return J_point * J_step;
}

std::optional<RefinedPose> refine_pose(const CameraModel& camera,
                                       std::span<const PointObservation> observations,
                                       const MapFromCamera& start, const RefinerOptions& options) {
  if (observations.size() < 3 || !start.is_finite()) return std::nullopt;
  const auto T_camera_map = start.inverse();
  for (const PointObservation& observation : observations) {
    if (!observation.p_map.allFinite() || !observation.pixel.allFinite()) return std::nullopt;
    if (!((T_camera_map * observation.p_map).z() > kMinDepth_m)) return std::nullopt;
  }

  const std::optional<MapFromCamera> minimum =
      options.by_ceres ? minimum_by_ceres(camera, observations, start, options)
                       : minimum_near(camera, observations, start, options);
  if (!minimum) return std::nullopt;

  RefinedPose result;
  result.T_map_camera = *minimum;
  if (!result.T_map_camera.is_finite()) return std::nullopt;
  // Computes the information of the weighted problem. Translations are scaled by the distance to
  // the points, so that all six directions are comparable.
  const auto T_refined = result.T_map_camera.inverse();
  Matrix6d information = Matrix6d::Zero();
  double sum = 0.0;
  double weighted_sum = 0.0;
  double distance = 0.0;
  for (const PointObservation& observation : observations) {
    const Eigen::Vector3d p = T_refined * observation.p_map;
    if (!(p.z() > kMinDepth_m)) return std::nullopt;
    const double error2 = (camera.project_unchecked(p) - observation.pixel).squaredNorm();
    const double error = std::sqrt(error2);
    const double weight = error > options.robust_scale_px ? options.robust_scale_px / error : 1.0;
    const Eigen::Matrix<double, 2, 6> J =
        reprojection_jacobian(camera, result.T_map_camera, observation.p_map);
    information += weight * J.transpose() * J;
    sum += error2;
    weighted_sum += weight * error2;
    distance += p.norm();
  }
  const auto count = static_cast<double>(observations.size());
  distance /= count;
  Vector6d scale;
  scale << distance, distance, distance, 1.0, 1.0, 1.0;
  const Matrix6d scaled = scale.asDiagonal() * information * scale.asDiagonal();
  if (!scaled.allFinite()) return std::nullopt;
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(scaled);
  if (!(eigen.eigenvalues()[0] > 1e-10 * eigen.eigenvalues()[5])) return std::nullopt;
  const Matrix6d inverse = eigen.eigenvectors() * eigen.eigenvalues().cwiseInverse().asDiagonal() *
                           eigen.eigenvectors().transpose();
  result.rms_px = std::sqrt(sum / count);
  // Variance per axis, plus 1 sigma of its uncertainty: chi-square with `freedom` degrees of
  // freedom has a relative sigma of sqrt(2 / freedom).
  const double freedom = std::max(2.0 * count - 6.0, 1.0);
  constexpr double floor2 = kCornerNoiseFloor_px * kCornerNoiseFloor_px;
  const double variance =
      std::max(weighted_sum / freedom, floor2) * (1.0 + std::sqrt(2.0 / freedom));
  result.noise_px = std::sqrt(variance);
  result.covariance = variance * (scale.asDiagonal() * inverse * scale.asDiagonal());
  if (!result.covariance.allFinite()) return std::nullopt;
  return result;
}

std::optional<RefinedPose> find_pose(const CameraModel& camera,
                                     std::span<const PointObservation> observations) {
  std::optional<RefinedPose> best;
  for (const MapFromCamera& start : solve_pose(camera, observations)) {
    const auto refined = refine_pose(camera, observations, start);
    if (refined && (!best || refined->rms_px < best->rms_px)) best = refined;
  }
  return best;
}

}  // namespace penumbra
