// What a step of our own is compared with: Levenberg and Marquardt's method by ceres::TinySolver.
//
// A solver that asks for each pixel's residual and derivatives would read the picture in double,
// pixel by pixel. It is given seven residuals in place of them, with the same normal equations and
// the same sum of squares (the compressed problem): with H = L L^T, those are L^-1 g and what of
// the sum is left, and their derivatives L^T and 0.

#include <ceres/tiny_solver.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <vector>

#include "tracking/alignment/tag_alignment_state.hpp"
#include "tracking/motion/se3.hpp"

namespace penumbra {
namespace {

// With the weights held, what a further one brings is gone with the next weights.
constexpr int kTinySolverIterations = 2;  // the first of them is none

// exp(xi + d) = exp(J d) exp(xi) to first order in d: the left Jacobian of SE(3), a series in the
// Lie algebra's adjoint of xi.
Matrix6d left_jacobian(const Vector6d& xi) {
  constexpr int kTerms = 10;  // for |xi| of 1 the next one is below 1e-7
  Matrix6d ad = Matrix6d::Zero();
  ad.topLeftCorner<3, 3>() = ad.bottomRightCorner<3, 3>() = skew(xi.tail<3>());
  ad.topRightCorner<3, 3>() = skew(xi.head<3>());
  Matrix6d term = Matrix6d::Identity();
  Matrix6d sum = term;
  for (int n = 1; n < kTerms; ++n) {
    term = term * ad / (n + 1.0);
    sum += term;
  }
  return sum;
}

}  // namespace

// The problem as the solver asks for it: at exp(xi) * T_begin, weights held, gains and offsets
// where they are best.
struct TagAligner::Impl::Compressed {
  using Scalar = double;
  enum { NUM_RESIDUALS = 7, NUM_PARAMETERS = 6 };

  Impl& aligner;
  Eigen::Isometry3d T_begin;
  // Of the last pose that was asked for: the solver asks twice for each that it takes.
  mutable Vector6d at = Vector6d::Zero();
  mutable Equations equations{};

  void go_to(const Vector6d& xi) const {
    if (xi == at) return;
    at = xi;
    aligner.T_camera_table = exp_se3(xi) * T_begin;
    for (Tag* tag : aligner.active) {
      aligner.place(*tag);
      if (tag->moments > 1) aligner.place_moments(*tag);
    }
    aligner.sum_up(0.0, equations);
  }

  // What the gains and offsets leave of the sum of squares.
  [[nodiscard]] double cost() const {
    double left = equations.cost;
    for (const kernel::TagPack& pack : aligner.packs) {
      for (int lane = 0; lane < 4; ++lane) {
        if (!pack.valid[lane]) continue;
        const double g0 = pack.g[6][lane];
        const double g1 = pack.g[7][lane];
        left -= pack.inverse[0][lane] * g0 * g0 + 2.0 * pack.inverse[1][lane] * g0 * g1 +
                pack.inverse[2][lane] * g1 * g1;
      }
    }
    return left;
  }

  bool operator()(const double* x, double* residuals, double* jacobian) const {
    const Eigen::Map<const Vector6d> xi(x);
    Eigen::Map<Eigen::Matrix<double, 7, 1>> r(residuals);
    if (!xi.allFinite()) {
      r.setConstant(1e100);
      return false;
    }
    go_to(xi);
    const Vector6d deviation = log_se3(aligner.T_camera_table * aligner.T_predicted.inverse());
    const Vector6d pull = aligner.prior_information * deviation;
    const Eigen::LLT<Matrix6d> llt(equations.H / aligner.variance + aligner.prior_information);
    const Vector6d g = equations.g / aligner.variance - pull;
    const Vector6d projected = llt.matrixL().solve(g);
    const double sum = cost() / aligner.variance + deviation.dot(pull);
    r.head<6>() = -projected;
    r[6] = std::sqrt(std::max(sum - projected.squaredNorm(), 0.0));
    if (!r.allFinite()) r.setConstant(1e100);
    if (jacobian != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 7, 6>> J(jacobian);
      J.topRows<6>() = Matrix6d(llt.matrixU()) * left_jacobian(xi);
      J.row(6).setZero();
    }
    return true;
  }
};

// Tukey's weights as they are at the current pose, and the best pose with these; else as `step`.
bool TagAligner::Impl::solve_by_tiny_solver(double cutoff, double& moved_px) {
  Compressed problem{.aligner = *this, .T_begin = T_camera_table};
  sum_up(cutoff, problem.equations);
  if (!take_variance(problem.equations)) return false;
  // The samples' own weights and their sums, until the end.
  std::vector<float> own_weights;
  std::vector<double> base_weights;
  for (Tag* tag : active) {
    const kernel::Samples& s = tag->samples;
    own_weights.insert(own_weights.end(), s.weight, s.weight + s.count);
    base_weights.push_back(tag->sums.base_weight);
    if (!(cutoff > 0.0) || tag->used < kFewestSamples || !(tag->gain > 1.0)) continue;
    const auto inverse_cutoff = static_cast<float>(1.0 / (tukey_share(cutoff) * tag->gain));
    for (int i = 0; i < s.count; ++i) {
      const float t = s.residual[i] * inverse_cutoff;
      const float inside = std::max(0.0F, 1.0F - t * t);
      s.weight[i] *= inside * inside;
    }
  }
  ceres::TinySolver<Compressed> solver;
  solver.options.max_num_iterations = kTinySolverIterations;
  // A lone tag's tilt is so weakly seen that the usual damping would hold it.
  solver.options.initial_trust_region_radius = 1e10;
  // Of chi-square: a hundredth of a standard deviation.
  solver.options.function_tolerance = 1e-4;
  Vector6d xi = Vector6d::Zero();
  solver.Solve(problem, &xi);
  const bool solved = xi.allFinite();
  problem.go_to(solved ? xi : Vector6d::Zero());
  const bool enough = take_variance(problem.equations);
  std::size_t at = 0;
  for (std::size_t k = 0; k < active.size(); ++k) {
    const kernel::Samples& s = active[k]->samples;
    std::copy_n(own_weights.begin() + static_cast<std::ptrdiff_t>(at), s.count, s.weight);
    at += static_cast<std::size_t>(s.count);
    active[k]->sums.base_weight = base_weights[k];
  }
  if (!solved || !enough) return false;
  last_step.setZero();
  step_slope = 1.0;
  step_sigmas = std::sqrt(std::max(xi.dot(information * xi), 0.0));
  // The equations are those of the pose itself: it was further off where the solver began.
  follow_tags(Vector6d::Zero(), problem.T_begin * T_camera_table.inverse(), moved_px);
  return true;
}

}  // namespace penumbra
