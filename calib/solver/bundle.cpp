#include "calib/solver/bundle.hpp"

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>

#include "calib/solver/packed_pose.hpp"
#include "calib/solver/silence.hpp"
#include "calib/solver/stop_callback.hpp"
#include "core/propagate.hpp"
#include "core/statistics.hpp"

namespace penumbra {
namespace {

CameraPose pose_of(const ViewParameters& view) {
  return unpacked<frame::Camera, frame::Table>(
             {view[0], view[1], view[2], view[3], view[4], view[5]})
      .inverse();
}

}  // namespace

LensParameters lens_of(const CameraParameters& p) {
  LensParameters lens = {p.fx, p.fy, p.cx, p.cy};
  std::copy(p.distortion.begin(), p.distortion.end(), lens.begin() + 4);
  return lens;
}

void set_lens(CameraParameters& p, const LensParameters& lens) {
  p.fx = lens[0];
  p.fy = lens[1];
  p.cx = lens[2];
  p.cy = lens[3];
  std::copy(lens.begin() + 4, lens.end(), p.distortion.begin());
}

ViewParameters view_of(const CameraPose& T_board_camera, double edge_shift_px) {
  const Pose6 pose = packed(T_board_camera.inverse());
  return {pose[0], pose[1], pose[2], pose[3], pose[4], pose[5], edge_shift_px};
}

Bundle::Bundle(int width, int height, std::span<const Eigen::Vector3d> board,
               std::span<const CalibrationView> views, const SolverOptions& options)
    : width_(width), height_(height), board_(board), views_(views), options_(options) {
  for (const Eigen::Vector3d& p : board) middle_ += p;
  middle_ /= static_cast<double>(board.size());
  for (const Eigen::Vector3d& p : board) radius_ = std::max(radius_, (p - middle_).norm());
  shapes_.resize(options.shape == BoardShape::free ? board.size() : 1, ShapeParameters{});
  for (const CalibrationView& view : views) {
    outlier_.push_back(view.outlier.empty() ? std::vector<bool>(view.corners.size(), false)
                                            : view.outlier);
    has_edge_shift_.push_back(std::ranges::any_of(
        view.corners, [](const TargetCorner& corner) { return !corner.spread.isZero(); }));
  }
}

void Bundle::start_shape(const CalibrationSolution& from) {
  if (options_.shape == BoardShape::free && from.board.size() == board_.size()) {
    for (std::size_t i = 0; i < board_.size(); ++i)
      Eigen::Map<Eigen::Vector3d>(shapes_[i].data()) = from.board[i] - board_[i];
  }
}

bool Bundle::solve(int free_coefficients, bool square_pixels, bool move_centre, double noise,
                   double robust_px, int iterations) {
  silence_solver();
  ceres::Problem::Options ownership;
  ownership.cost_function_ownership = ceres::TAKE_OWNERSHIP;
  ceres::Problem problem(ownership);
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  problem.AddParameterBlock(lens.data(), kLensSize);
  std::vector<int> fixed;
  if (square_pixels) fixed.push_back(1);
  if (!move_centre) {
    fixed.push_back(2);
    fixed.push_back(3);
  }
  const int count = coefficients();
  for (int i = 0; i < 8; ++i) {
    if (i >= std::min(count, free_coefficients)) fixed.push_back(4 + i);
  }
  if (!fixed.empty()) problem.SetManifold(lens.data(), new ceres::SubsetManifold(kLensSize, fixed));
  ordering->AddElementToGroup(lens.data(), 1);
  for (ShapeParameters& shape : shapes_) {
    problem.AddParameterBlock(shape.data(), 3);
    ordering->AddElementToGroup(shape.data(), 1);
    if (options_.shape == BoardShape::rigid) problem.SetParameterBlockConstant(shape.data());
  }
  for (std::size_t v = 0; v < views_.size(); ++v) {
    problem.AddParameterBlock(poses[v].data(), kViewSize);
    ordering->AddElementToGroup(poses[v].data(), 0);
    if (!has_edge_shift_[v])
      problem.SetManifold(poses[v].data(), new ceres::SubsetManifold(kViewSize, {6}));
    else
      problem.AddResidualBlock(edge_shift_prior().release(),
                               new ceres::ScaledLoss(nullptr, noise * noise, ceres::TAKE_OWNERSHIP),
                               poses[v].data());
    for (std::size_t c = 0; c < views_[v].corners.size(); ++c) {
      if (outlier_[v][c]) continue;
      const TargetCorner& corner = views_[v].corners[c];
      problem.AddResidualBlock(corner_cost(term_of(corner)).release(),
                               robust_px > 0.0 ? new ceres::CauchyLoss(robust_px) : nullptr,
                               lens.data(), poses[v].data(), shape_of(corner.point).data());
    }
  }
  if (options_.model == DistortionModel::rational) {
    problem.AddResidualBlock(rational_prior(max_image_radius()).release(),
                             new ceres::ScaledLoss(nullptr, noise * noise, ceres::TAKE_OWNERSHIP),
                             lens.data());
  }
  if (options_.shape == BoardShape::free) {
    for (ShapeParameters& shape : shapes_) {
      problem.AddResidualBlock(offset_prior(prior_sigma()).release(),
                               new ceres::ScaledLoss(nullptr, noise * noise, ceres::TAKE_OWNERSHIP),
                               shape.data());
    }
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = ordering;
  options.max_num_iterations = iterations;
  options.function_tolerance = 1e-9;
  options.parameter_tolerance = 1e-10;
  options.gradient_tolerance = 1e-12;
  options.num_threads = 1;  // for reproducible sums
  options.logging_type = ceres::SILENT;
  StopCallback stop(options_.stop);
  options.callbacks.push_back(&stop);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return false;
  if (square_pixels) lens[1] = lens[0];
  return std::ranges::all_of(lens, [](double x) { return std::isfinite(x); }) && lens[0] > 1.0 &&
         lens[1] > 1.0;
}

std::optional<Eigen::Vector2d> Bundle::residual(std::size_t v, std::size_t c) {
  const TargetCorner& corner = views_[v].corners[c];
  const std::array<const double*, 3> at = {lens.data(), poses[v].data(),
                                           shape_of(corner.point).data()};
  Eigen::Vector2d r;
  if (!corner_cost(term_of(corner))->Evaluate(at.data(), r.data(), nullptr)) return std::nullopt;
  return r;
}

double Bundle::residual_quantile(double fraction) {
  std::vector<double> distances;
  for (std::size_t v = 0; v < views_.size(); ++v) {
    for (std::size_t c = 0; c < views_[v].corners.size(); ++c) {
      if (!views_[v].counts(c)) continue;
      const auto r = residual(v, c);
      distances.push_back(r ? r->norm() : 1e6);
    }
  }
  if (distances.empty()) return 1.0;
  return order_statistic(std::move(distances), fraction);
}

bool Bundle::mark_outliers(double limit_px) {
  bool changed = false;
  for (std::size_t v = 0; v < views_.size(); ++v) {
    if (!views_[v].outlier.empty()) continue;
    std::vector<bool> marks(views_[v].corners.size(), false);
    std::size_t inliers = marks.size();
    for (std::size_t c = 0; c < marks.size(); ++c) {
      const auto r = residual(v, c);
      marks[c] = !r || r->norm() > limit_px;
      if (marks[c]) --inliers;
    }
    if (inliers < 4) marks.assign(marks.size(), false);
    changed = changed || marks != outlier_[v];
    outlier_[v] = std::move(marks);
  }
  return changed;
}

Result<CalibrationSolution> Bundle::finish() {
  CalibrationSolution solution;
  CameraParameters parameters;
  parameters.width = width_;
  parameters.height = height_;
  parameters.model = options_.model;
  set_lens(parameters, lens);
  PENUMBRA_TRY(solution.camera, CameraModel::make(parameters));
  solution.shape = options_.shape;
  solution.board.assign(board_.begin(), board_.end());
  for (std::size_t i = 0; i < board_.size(); ++i) {
    const ShapeParameters& s = options_.shape == BoardShape::free ? shapes_[i] : shapes_[0];
    if (options_.shape == BoardShape::bowed) {
      solution.board[i].z() += warp_of(board_[i]).dot(Eigen::Vector3d(s[0], s[1], s[2]));
    } else {
      solution.board[i] += Eigen::Vector3d(s[0], s[1], s[2]);
    }
  }

  const int n_lens = 4 + coefficients();
  const int n_shape =
      options_.shape == BoardShape::rigid ? 0 : static_cast<int>(3 * shapes_.size());
  const int n = n_lens + n_shape;
  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(n, n);
  // Score (gradient) of lens and shape for each view, with the view's pose marginalised.
  std::vector<Eigen::VectorXd> scores;
  double sum = 0.0;
  double sum_all = 0.0;
  for (std::size_t v = 0; v < views_.size(); ++v) {
    SolvedView view;
    view.T_board_camera = pose_of(poses[v]);
    view.edge_shift_px = poses[v][6];
    Eigen::MatrixXd B = Eigen::MatrixXd::Zero(n, kViewSize);
    Eigen::Matrix<double, kViewSize, kViewSize> C =
        Eigen::Matrix<double, kViewSize, kViewSize>::Zero();
    Eigen::VectorXd g = Eigen::VectorXd::Zero(n);
    Eigen::Matrix<double, kViewSize, 1> h = Eigen::Matrix<double, kViewSize, 1>::Zero();
    double sum_view = 0.0;
    int used = 0;
    for (std::size_t c = 0; c < views_[v].corners.size(); ++c) {
      const TargetCorner& corner = views_[v].corners[c];
      ShapeParameters& shape = shape_of(corner.point);
      const std::array<const double*, 3> at = {lens.data(), poses[v].data(), shape.data()};
      Eigen::Vector2d r;
      Eigen::Matrix<double, 2, kLensSize, Eigen::RowMajor> J_lens;
      Eigen::Matrix<double, 2, kViewSize, Eigen::RowMajor> J_view;
      Eigen::Matrix<double, 2, 3, Eigen::RowMajor> J_shape;
      std::array<double*, 3> jacobians = {J_lens.data(), J_view.data(), J_shape.data()};
      if (!corner_cost(term_of(corner))->Evaluate(at.data(), r.data(), jacobians.data()))
        return fail("a view ended up behind the camera; take views with the target tilted more");
      view.residuals_px.push_back(r);
      view.outlier.push_back(outlier_[v][c]);
      sum_all += r.squaredNorm();
      ++solution.corners;
      if (outlier_[v][c]) {
        ++solution.outliers;
        continue;
      }
      sum_view += r.squaredNorm();
      ++used;
      if (!has_edge_shift_[v]) J_view.col(6).setZero();
      const auto J_l = J_lens.leftCols(n_lens);
      S.topLeftCorner(n_lens, n_lens) += J_l.transpose() * J_l;
      B.topRows(n_lens) += J_l.transpose() * J_view;
      C += J_view.transpose() * J_view;
      g.head(n_lens) += J_l.transpose() * r;
      h += J_view.transpose() * r;
      if (n_shape > 0) {
        const int first = n_lens + (options_.shape == BoardShape::free ? 3 * corner.point : 0);
        S.block(first, first, 3, 3) += J_shape.transpose() * J_shape;
        const Eigen::MatrixXd across = J_l.transpose() * J_shape;
        S.block(0, first, n_lens, 3) += across;
        S.block(first, 0, 3, n_lens) += across.transpose();
        B.middleRows(first, 3) += J_shape.transpose() * J_view;
        g.segment(first, 3) += J_shape.transpose() * r;
      }
    }
    C(6, 6) += has_edge_shift_[v] ? 1e-6 : 1.0;
    const Eigen::LDLT<Eigen::Matrix<double, kViewSize, kViewSize>> pose(C);
    const Eigen::MatrixXd BC = pose.solve(B.transpose()).transpose();
    S -= BC * B.transpose();
    scores.emplace_back(g - BC * h);
    view.rms_px = std::sqrt(sum_view / std::max(used, 1));
    sum += sum_view;
    solution.views.push_back(std::move(view));
  }
  const int inliers = solution.corners - solution.outliers;
  const double dof = 2.0 * inliers - n_lens - 6.0 * static_cast<double>(views_.size());
  if (dof < 10.0) {
    return fail("{} corners in {} views do not determine a camera; take more views", inliers,
                views_.size());
  }
  solution.noise_px = std::sqrt(sum / dof);
  solution.rms_px = std::sqrt(sum / inliers);
  solution.rms_all_px = std::sqrt(sum_all / solution.corners);
  if (options_.model == DistortionModel::rational) {
    Eigen::Matrix<double, kRationalPriorSize, 1> r;
    Eigen::Matrix<double, kRationalPriorSize, kLensSize, Eigen::RowMajor> J;
    const double* at = lens.data();
    double* jacobian = J.data();
    rational_prior(max_image_radius())->Evaluate(&at, r.data(), &jacobian);
    S.topLeftCorner(n_lens, n_lens) +=
        solution.noise_px * solution.noise_px * J.leftCols(n_lens).transpose() * J.leftCols(n_lens);
  }
  if (options_.shape == BoardShape::free) {
    const Eigen::Vector3d information = (solution.noise_px / prior_sigma().array()).square();
    for (int i = n_lens; i < n; ++i) S(i, i) += information[(i - n_lens) % 3];
  }
  // Scales the diagonal to 1, because the parameters differ by orders of magnitude.
  const Eigen::VectorXd scale = S.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled = scale.asDiagonal() * S * scale.asDiagonal();
  const Eigen::LDLT<Eigen::MatrixXd> factor(scaled);
  Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(n, n));
  if (options_.model == DistortionModel::rational &&
      !(inverse.diagonal().minCoeff() > 0.0 && inverse.allFinite())) {
    // Only the prior constrains a common factor of numerator and denominator, so weakly that
    // rounding errors dominate. The factor moves no pixel, so its variance is limited.
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scaled);
    constexpr double kRounding = 1e-13;
    const Eigen::VectorXd values = eigen.eigenvalues().cwiseMax(kRounding);
    inverse = eigen.eigenvectors() * values.cwiseInverse().asDiagonal() *
              eigen.eigenvectors().transpose();
  }
  inverse = scale.asDiagonal() * inverse * scale.asDiagonal();
  const Eigen::MatrixXd lens_inverse = inverse.topLeftCorner(n_lens, n_lens);
  if (factor.info() != Eigen::Success || !lens_inverse.allFinite() ||
      !(lens_inverse.diagonal().minCoeff() > 0.0)) {
    return fail("the views do not determine the camera; tilt the target in several directions");
  }
  // Residuals of one view are correlated (blur, light, board warp). Covariance inflation: ratio of
  // the traces of the sandwich estimate, clustered by view, and the plain estimate, for the lens
  // parameters.
  Eigen::MatrixXd meat = Eigen::MatrixXd::Zero(n_lens, n_lens);
  for (const Eigen::VectorXd& score : scores) {
    const Eigen::VectorXd step = inverse.topRows(n_lens) * score;
    meat += step * step.transpose();
  }
  const double n_views = static_cast<double>(views_.size());
  meat *= n_views / std::max(n_views - 1.0, 1.0);
  const Eigen::LDLT<Eigen::MatrixXd> plain(scale.head(n_lens).cwiseInverse().asDiagonal() *
                                           lens_inverse *
                                           scale.head(n_lens).cwiseInverse().asDiagonal());
  const Eigen::MatrixXd ratio = plain.solve(scale.head(n_lens).cwiseInverse().asDiagonal() * meat *
                                            scale.head(n_lens).cwiseInverse().asDiagonal());
  const double clustered = ratio.trace() / n_lens / (solution.noise_px * solution.noise_px);
  solution.covariance_inflation =
      std::isfinite(clustered) ? std::clamp(clustered, 1.0, 100.0) : 1.0;
  // Fixed parameters have no variance.
  const int n_all = 4 + coefficient_count(options_.model);
  solution.covariance = Eigen::MatrixXd::Zero(n_all, n_all);
  solution.covariance.topLeftCorner(n_lens, n_lens) =
      lens_inverse * (solution.noise_px * solution.noise_px * solution.covariance_inflation);
  return solution;
}

Eigen::Vector3d Bundle::prior_sigma() const {
  // Printers are more accurate than paper is flat; see docs/calibration.md#board-warp.
  const double out_of_plane = radius_ / 500.0;
  const double in_plane = 0.1 * out_of_plane;
  return {in_plane, in_plane, out_of_plane};
}

double Bundle::max_image_radius() const {
  constexpr double kMaxAngle = 1.35;  // [rad] from the axis
  // Assumes an equidistant lens; for lenses with less distortion this is an upper bound.
  return std::tan(
      std::min(0.5 * std::hypot(width_, height_) / std::sqrt(lens[0] * lens[1]), kMaxAngle));
}

Eigen::Vector3d Bundle::warp_of(const Eigen::Vector3d& p) const {
  const Eigen::Vector3d q = (p - middle_) / radius_;
  return {q.x() * q.x(), q.y() * q.y(), q.x() * q.y()};
}

CornerTerm Bundle::term_of(const TargetCorner& corner) const {
  const Eigen::Vector3d& p = board_[static_cast<std::size_t>(corner.point)];
  return {options_.model, p, warp_of(p), options_.shape == BoardShape::bowed, corner.pixel,
          corner.spread};
}

}  // namespace penumbra
