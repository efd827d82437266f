#include "tracking/alignment/displacement_fit.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "tracking/math/se3.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kFewestToJudge = 5;  // tags: how well they agree

PointJacobian jacobian_of(const Eigen::Matrix<double, 2, 3>& J_p, const Eigen::Vector3d& p) {
  PointJacobian J;
  J << J_p, -J_p * skew(p);
  return J;
}
// Adds w J^T J to the lower triangle.
void add_point(const PointJacobian& J, double w, Matrix6d& H) {
#pragma GCC unroll 6
  for (int row = 0; row < 6; ++row) {
    const double w0 = w * J(0, row);
    const double w1 = w * J(1, row);
#pragma GCC unroll 6
    for (int column = 0; column <= row; ++column)
      H(row, column) += w0 * J(0, column) + w1 * J(1, column);
  }
}

}  // namespace

PointJacobian jacobian_at(const CameraModel& camera, const Eigen::Vector3d& p) {
  Eigen::Matrix<double, 2, 3> J_p;
  static_cast<void>(camera.project_unchecked(p, &J_p));
  return jacobian_of(J_p, p);
}

// Gauss-Newton on the left perturbation of T_camera_table. The rounds of weights start wide and
// close in, so that a few wrong peaks are left behind.
bool fit_displaced(const std::vector<DisplacedTag>& displaced, AlignmentProblem& problem) {
  Eigen::Isometry3d T = problem.T_camera_table;
  for (int round = 0; round < 4; ++round) {
    const double cutoff = round == 0 ? 1e9 : (round == 1 ? 12.0 : 6.0);
    const Vector6d deviation = log_se3(T * problem.T_predicted.inverse());
    Matrix6d H = problem.prior_information;
    Vector6d g = -problem.prior_information * deviation;
    for (const DisplacedTag& d : displaced) {
      const Eigen::Vector3d p = T * d.p;
      if (!(p.z() > 0.0)) continue;
      Eigen::Matrix<double, 2, 3> J_p;
      const Eigen::Vector2d r = d.z - problem.camera.project_unchecked(p, &J_p);
      const double t = r.norm() / (d.sigma_px * cutoff);
      if (t >= 1.0) continue;
      const double w = (1.0 - t * t) * (1.0 - t * t) / (d.sigma_px * d.sigma_px);
      const PointJacobian J = jacobian_of(J_p, p);
      add_point(J, w, H);
      g += J.transpose() * (w * r);
    }
    const Vector6d xi = solve_spd(H, g);
    if (!xi.allFinite()) return false;
    T = exp_se3(xi) * T;
  }
  problem.T_camera_table = T;
  return true;
}

double fit_error_px(const std::vector<DisplacedTag>& displaced, const AlignmentProblem& problem) {
  // Few tags say little of their scatter: it is as if four numbers more had said a twentieth of a
  // cell.
  constexpr double kScatter_cells = 0.05;
  constexpr double kScatterNumbers = 4.0;
  if (displaced.size() < kFewestToJudge) return std::numeric_limits<double>::infinity();
  double sum2 = 0.0;
  double cells = 0.0;
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  Matrix6d H = Matrix6d::Zero();
  for (const DisplacedTag& d : displaced) {
    if (d.open) return std::numeric_limits<double>::infinity();
    const Eigen::Vector3d p = problem.T_camera_table * d.p;
    Eigen::Matrix<double, 2, 3> J_p;
    sum2 += (d.z - problem.camera.project_unchecked(p, &J_p)).squaredNorm();
    add_point(jacobian_of(J_p, p), 1.0, H);
    cells += d.cell_px;
    middle += d.z;
  }
  const auto n = static_cast<double>(displaced.size());
  middle /= n;
  const double scatter2 = (sum2 + kScatterNumbers * std::pow(kScatter_cells * cells / n, 2)) /
                          (2.0 * n - 6.0 + kScatterNumbers);
  const Matrix6d covariance = inverse_of_spd(H / scatter2 + problem.prior_information);
  double largest2 = 0.0;
  for (const AlignedTag* tag : problem.active) {
    // The corner that is farthest from the middle.
    const std::size_t first = tag->search_cells.size();
    double farthest2 = -1.0;
    std::size_t corner = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      const double distance2 =
          (Eigen::Vector2d(tag->search_x[first + k], tag->search_y[first + k]) - middle)
              .squaredNorm();
      if (!(distance2 > farthest2)) continue;
      farthest2 = distance2;
      corner = k;
    }
    const double last = tag->side - 1;
    const Eigen::Vector3d p = tag->point(corner % 2 == 0 ? 0.0 : last, corner < 2 ? 0.0 : last);
    const PointJacobian J = jacobian_at(problem.camera, p);
    largest2 = std::max(largest2, (J * covariance * J.transpose()).trace());
  }
  return std::sqrt(largest2);
}

}  // namespace penumbra
