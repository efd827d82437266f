#include "calib/intrinsics_solver.hpp"

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <glog/logging.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <tuple>

#include "tracking/pose_refiner.hpp"
#include "tracking/pose_solver.hpp"

namespace penumbra {
namespace {

constexpr int kLens = 12;                // fx fy cx cy k[8]
constexpr int kView = 7;                 // angle-axis and translation of T_camera_board, edge shift
constexpr double kEdgeShiftPrior = 1.0;  // [px]
constexpr double kNearest = 1e-6;        // [m] in front of the camera

using LensParameters = std::array<double, kLens>;
using ViewParameters = std::array<double, kView>;
using ShapeParameters = std::array<double, 3>;

int lens_count(DistortionModel model) {
  return 4 + coefficient_count(model);
}

LensParameters lens_of(const CameraParameters& p) {
  LensParameters lens = {p.fx, p.fy, p.cx, p.cy};
  std::copy(p.distortion.begin(), p.distortion.end(), lens.begin() + 4);
  return lens;
}

CameraParameters camera_of(const LensParameters& lens, DistortionModel model, int width,
                           int height) {
  CameraParameters p;
  p.width = width;
  p.height = height;
  p.fx = lens[0];
  p.fy = lens[1];
  p.cx = lens[2];
  p.cy = lens[3];
  p.model = model;
  for (std::size_t i = 0; i < static_cast<std::size_t>(coefficient_count(model)); ++i)
    p.distortion[i] = lens[4 + i];
  return p;
}

ViewParameters view_of(const CameraPose& T_board_camera, double edge_shift_px) {
  const auto T_camera_board = T_board_camera.inverse();
  const Eigen::AngleAxisd turn(T_camera_board.rotation());
  const Eigen::Vector3d axis = turn.angle() * turn.axis();
  const Eigen::Vector3d& t = T_camera_board.translation();
  return {axis.x(), axis.y(), axis.z(), t.x(), t.y(), t.z(), edge_shift_px};
}

CameraPose pose_of(const ViewParameters& view) {
  const Eigen::Vector3d axis(view[0], view[1], view[2]);
  const double angle = axis.norm();
  const Eigen::Quaterniond q = angle < 1e-12
                                   ? Eigen::Quaterniond::Identity()
                                   : Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis / angle));
  return Transform<frame::Camera, frame::Table>(q, Eigen::Vector3d(view[3], view[4], view[5]))
      .inverse();
}

// One corner. The shape block is the bow's three numbers or the point's own offset.
struct CornerCost {
  DistortionModel model;
  Eigen::Vector3d point;
  Eigen::Vector3d bow;  // x^2, y^2, x y on the board; zero when the block is an offset
  bool bowed = false;
  Eigen::Vector2d pixel;
  Eigen::Vector2d spread;

  template <class T>
  bool operator()(const T* lens, const T* view, const T* shape, T* residual) const {
    T p[3] = {T(point.x()), T(point.y()), T(point.z())};
    if (bowed) {
      p[2] += shape[0] * bow.x() + shape[1] * bow.y() + shape[2] * bow.z();
    } else {
      for (int i = 0; i < 3; ++i) p[i] += shape[i];
    }
    T q[3];
    ceres::AngleAxisRotatePoint(view, p, q);
    for (int i = 0; i < 3; ++i) q[i] += view[3 + i];
    if (!(q[2] > T(kNearest))) return false;  // Ceres takes a shorter step
    std::array<T, 8> k;
    std::copy(lens + 4, lens + kLens, k.begin());
    T x_d;
    T y_d;
    distort<T>(model, k, q[0] / q[2], q[1] / q[2], x_d, y_d);
    residual[0] = lens[0] * x_d + lens[2] + view[6] * spread.x() - pixel.x();
    residual[1] = lens[1] * y_d + lens[3] + view[6] * spread.y() - pixel.y();
    return true;
  }
};
using CornerFunction = ceres::AutoDiffCostFunction<CornerCost, 2, kLens, kView, 3>;

struct EdgeShiftPrior {
  template <class T>
  bool operator()(const T* view, T* residual) const {
    residual[0] = view[6] / kEdgeShiftPrior;
    return true;
  }
};

struct OffsetPrior {
  double sigma;
  template <class T>
  bool operator()(const T* shape, T* residual) const {
    for (int i = 0; i < 3; ++i) residual[i] = shape[i] / sigma;
    return true;
  }
};

// All that is solved for, and what it is measured by.
class Bundle {
 public:
  Bundle(int width, int height, std::span<const Eigen::Vector3d> board,
         std::span<const CalibrationView> views, const SolverOptions& options)
      : width_(width), height_(height), board_(board), views_(views), options_(options) {
    for (const Eigen::Vector3d& p : board) middle_ += p;
    middle_ /= static_cast<double>(board.size());
    for (const Eigen::Vector3d& p : board) radius_ = std::max(radius_, (p - middle_).norm());
    shapes_.resize(options.shape == BoardShape::free ? board.size() : 1, ShapeParameters{});
    for (const CalibrationView& view : views) {
      outlier_.emplace_back(view.corners.size(), false);
      bool shifts = false;
      for (const TargetCorner& corner : view.corners) shifts = shifts || !corner.spread.isZero();
      shifts_.push_back(shifts);
    }
  }

  LensParameters lens{};
  std::vector<ViewParameters> poses;

  [[nodiscard]] double prior_sigma() const {
    return options_.free_prior_m > 0.0 ? options_.free_prior_m : radius_ / 500.0;
  }

  void start_shape(const CalibrationSolution& from) {
    if (options_.shape == BoardShape::free && from.board.size() == board_.size()) {
      for (std::size_t i = 0; i < board_.size(); ++i)
        Eigen::Map<Eigen::Vector3d>(shapes_[i].data()) = from.board[i] - board_[i];
    }
  }

  // `free_coefficients`: how many of k1, k2, ... may move; `noise`: of one axis, weighs the priors
  // [px]; `robust_px`: scale of the loss, 0 for none.
  bool solve(int free_coefficients, bool square_pixels, bool move_centre, double noise,
             double robust_px, int iterations) {
    // Ceres says on standard error what it tries in vain; what matters is in the result.
    FLAGS_minloglevel = std::max(FLAGS_minloglevel, static_cast<int>(google::GLOG_ERROR));
    ceres::Problem::Options ownership;
    ownership.cost_function_ownership = ceres::TAKE_OWNERSHIP;
    ceres::Problem problem(ownership);
    auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    problem.AddParameterBlock(lens.data(), kLens);
    std::vector<int> fixed;
    if (square_pixels) fixed.push_back(1);
    if (!move_centre) fixed.insert(fixed.end(), {2, 3});
    const int count = coefficient_count(options_.model);
    for (int i = 0; i < 8; ++i) {
      if (i >= std::min(count, free_coefficients)) fixed.push_back(4 + i);
    }
    if (!fixed.empty()) problem.SetManifold(lens.data(), new ceres::SubsetManifold(kLens, fixed));
    ordering->AddElementToGroup(lens.data(), 1);
    for (ShapeParameters& shape : shapes_) {
      problem.AddParameterBlock(shape.data(), 3);
      ordering->AddElementToGroup(shape.data(), 1);
      if (options_.shape == BoardShape::rigid) problem.SetParameterBlockConstant(shape.data());
    }
    for (std::size_t v = 0; v < views_.size(); ++v) {
      problem.AddParameterBlock(poses[v].data(), kView);
      ordering->AddElementToGroup(poses[v].data(), 0);
      if (!shifts_[v])
        problem.SetManifold(poses[v].data(), new ceres::SubsetManifold(kView, {6}));
      else
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<EdgeShiftPrior, 1, kView>(new EdgeShiftPrior),
            new ceres::ScaledLoss(nullptr, noise * noise, ceres::TAKE_OWNERSHIP), poses[v].data());
      for (std::size_t c = 0; c < views_[v].corners.size(); ++c) {
        if (outlier_[v][c]) continue;
        const TargetCorner& corner = views_[v].corners[c];
        problem.AddResidualBlock(new CornerFunction(new CornerCost(cost_of(corner))),
                                 robust_px > 0.0 ? new ceres::CauchyLoss(robust_px) : nullptr,
                                 lens.data(), poses[v].data(), shape_of(corner.point).data());
      }
    }
    if (options_.shape == BoardShape::free) {
      for (ShapeParameters& shape : shapes_) {
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<OffsetPrior, 3, 3>(new OffsetPrior{prior_sigma()}),
            new ceres::ScaledLoss(nullptr, noise * noise, ceres::TAKE_OWNERSHIP), shape.data());
      }
    }
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_SCHUR;
    options.linear_solver_ordering = ordering;
    options.max_num_iterations = iterations;
    options.function_tolerance = 1e-9;
    options.parameter_tolerance = 1e-10;
    options.gradient_tolerance = 1e-12;
    options.num_threads = 1;  // the same sums in the same order, every time
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    if (!summary.IsSolutionUsable()) return false;
    if (square_pixels) lens[1] = lens[0];
    return std::all_of(lens.begin(), lens.end(), [](double x) { return std::isfinite(x); }) &&
           lens[0] > 1.0 && lens[1] > 1.0;
  }

  // (projected - measured) of a corner; nothing behind the camera.
  [[nodiscard]] std::optional<Eigen::Vector2d> residual(std::size_t v, std::size_t c) {
    const TargetCorner& corner = views_[v].corners[c];
    Eigen::Vector2d r;
    if (!cost_of(corner)(lens.data(), poses[v].data(), shape_of(corner.point).data(), r.data()))
      return std::nullopt;
    return r;
  }

  // Spread of one axis by the median of distances (that of a 2-D normal is 1.1774 sigma).
  [[nodiscard]] double robust_noise() {
    std::vector<double> distances;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      for (std::size_t c = 0; c < views_[v].corners.size(); ++c) {
        const auto r = residual(v, c);
        distances.push_back(r ? r->norm() : 1e6);
      }
    }
    if (distances.empty()) return 1.0;
    const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
    std::nth_element(distances.begin(), middle, distances.end());
    return std::max(*middle / 1.1774, 1e-4);
  }

  // Whether the choice of outliers changed. Never takes so many of a view that no pose is left.
  bool mark_outliers(double limit_px) {
    bool changed = false;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      std::vector<bool> marks(views_[v].corners.size(), false);
      std::size_t left = marks.size();
      for (std::size_t c = 0; c < marks.size(); ++c) {
        const auto r = residual(v, c);
        marks[c] = !r || r->norm() > limit_px;
        if (marks[c]) --left;
      }
      if (left < 4) marks.assign(marks.size(), false);
      changed = changed || marks != outlier_[v];
      outlier_[v] = std::move(marks);
    }
    return changed;
  }

  // Normal equations, views eliminated, and from them the covariance of the lens.
  Result<CalibrationSolution> finish() {
    CalibrationSolution solution;
    const Result<CameraModel> camera =
        CameraModel::make(camera_of(lens, options_.model, width_, height_));
    if (!camera) return tl::unexpected(camera.error());
    solution.camera = *camera;
    solution.shape = options_.shape;
    solution.board.assign(board_.begin(), board_.end());
    for (std::size_t i = 0; i < board_.size(); ++i) {
      const ShapeParameters& s = options_.shape == BoardShape::free ? shapes_[i] : shapes_[0];
      if (options_.shape == BoardShape::bowed) {
        solution.board[i].z() += bow_of(board_[i]).dot(Eigen::Vector3d(s[0], s[1], s[2]));
      } else {
        solution.board[i] += Eigen::Vector3d(s[0], s[1], s[2]);
      }
    }

    const int n_lens = lens_count(options_.model);
    const int n_shape =
        options_.shape == BoardShape::rigid ? 0 : static_cast<int>(3 * shapes_.size());
    const int n = n_lens + n_shape;
    Eigen::MatrixXd S = Eigen::MatrixXd::Zero(n, n);
    // Per view, the score (gradient) of the lens and shape, poses eliminated.
    std::vector<Eigen::VectorXd> scores;
    double sum = 0.0;
    double sum_all = 0.0;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      SolvedView view;
      view.T_board_camera = pose_of(poses[v]);
      view.edge_shift_px = poses[v][6];
      Eigen::MatrixXd B = Eigen::MatrixXd::Zero(n, kView);
      Eigen::Matrix<double, kView, kView> C = Eigen::Matrix<double, kView, kView>::Zero();
      Eigen::VectorXd g = Eigen::VectorXd::Zero(n);
      Eigen::Matrix<double, kView, 1> h = Eigen::Matrix<double, kView, 1>::Zero();
      double sum_view = 0.0;
      int used = 0;
      for (std::size_t c = 0; c < views_[v].corners.size(); ++c) {
        const TargetCorner& corner = views_[v].corners[c];
        ShapeParameters& shape = shape_of(corner.point);
        const CornerFunction function(new CornerCost(cost_of(corner)));
        const std::array<const double*, 3> at = {lens.data(), poses[v].data(), shape.data()};
        Eigen::Vector2d r;
        Eigen::Matrix<double, 2, kLens, Eigen::RowMajor> J_lens;
        Eigen::Matrix<double, 2, kView, Eigen::RowMajor> J_view;
        Eigen::Matrix<double, 2, 3, Eigen::RowMajor> J_shape;
        std::array<double*, 3> jacobians = {J_lens.data(), J_view.data(), J_shape.data()};
        if (!function.Evaluate(at.data(), r.data(), jacobians.data()))
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
        if (!shifts_[v]) J_view.col(6).setZero();
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
      C(6, 6) += shifts_[v] ? 1e-6 : 1.0;
      const Eigen::LDLT<Eigen::Matrix<double, kView, kView>> pose(C);
      const Eigen::MatrixXd BC = pose.solve(B.transpose()).transpose();
      S -= BC * B.transpose();
      scores.emplace_back(g - BC * h);
      view.rms_px = std::sqrt(sum_view / std::max(used, 1));
      sum += sum_view;
      solution.views.push_back(std::move(view));
    }
    const int inliers = solution.corners - solution.outliers;
    const double freedom = 2.0 * inliers - n_lens - 6.0 * static_cast<double>(views_.size());
    if (freedom < 10.0) {
      return fail("{} corners in {} views do not fix a camera; take more views", inliers,
                  views_.size());
    }
    solution.noise_px = std::sqrt(sum / freedom);
    solution.rms_px = std::sqrt(sum / inliers);
    solution.rms_all_px = std::sqrt(sum_all / solution.corners);
    if (options_.shape == BoardShape::free) {
      const double information = std::pow(solution.noise_px / prior_sigma(), 2);
      for (int i = n_lens; i < n; ++i) S(i, i) += information;
    }
    // Parameters of very different sizes: scaled to ones on the diagonal.
    const Eigen::VectorXd scale = S.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
    const Eigen::MatrixXd scaled = scale.asDiagonal() * S * scale.asDiagonal();
    const Eigen::LDLT<Eigen::MatrixXd> factor(scaled);
    Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(n, n));
    inverse = scale.asDiagonal() * inverse * scale.asDiagonal();
    const Eigen::MatrixXd lens_inverse = inverse.topLeftCorner(n_lens, n_lens);
    if (factor.info() != Eigen::Success || !lens_inverse.allFinite() ||
        !(lens_inverse.diagonal().minCoeff() > 0.0)) {
      return fail("the views do not fix the camera; tilt the target in several directions");
    }
    // Residuals of one view hang together (blur, light, a board that is not flat): compare what
    // the views' scores scatter by with what independent noise would make them scatter by, in the
    // directions of the lens (the trace of a sandwich estimate over that of the plain one).
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
    const Eigen::MatrixXd ratio =
        plain.solve(scale.head(n_lens).cwiseInverse().asDiagonal() * meat *
                    scale.head(n_lens).cwiseInverse().asDiagonal());
    const double clustered = ratio.trace() / n_lens / (solution.noise_px * solution.noise_px);
    solution.clustering = std::isfinite(clustered) ? std::clamp(clustered, 1.0, 100.0) : 1.0;
    solution.covariance =
        lens_inverse * (solution.noise_px * solution.noise_px * solution.clustering);
    return solution;
  }

 private:
  [[nodiscard]] Eigen::Vector3d bow_of(const Eigen::Vector3d& p) const {
    const Eigen::Vector3d q = (p - middle_) / radius_;
    return {q.x() * q.x(), q.y() * q.y(), q.x() * q.y()};
  }
  [[nodiscard]] CornerCost cost_of(const TargetCorner& corner) const {
    const Eigen::Vector3d& p = board_[static_cast<std::size_t>(corner.point)];
    return {options_.model, p, bow_of(p), options_.shape == BoardShape::bowed, corner.pixel,
            corner.spread};
  }
  [[nodiscard]] ShapeParameters& shape_of(int point) {
    return options_.shape == BoardShape::free ? shapes_[static_cast<std::size_t>(point)]
                                              : shapes_[0];
  }

  int width_;
  int height_;
  std::span<const Eigen::Vector3d> board_;
  std::span<const CalibrationView> views_;
  SolverOptions options_;
  Eigen::Vector3d middle_ = Eigen::Vector3d::Zero();
  double radius_ = 0.0;
  std::vector<ShapeParameters> shapes_;
  std::vector<std::vector<bool>> outlier_;
  std::vector<bool> shifts_;
};

std::vector<PointObservation> observations_of(const CalibrationView& view,
                                              std::span<const Eigen::Vector3d> board) {
  std::vector<PointObservation> observations;
  for (const TargetCorner& corner : view.corners)
    observations.push_back({board[static_cast<std::size_t>(corner.point)], corner.pixel});
  return observations;
}

// Median distance of projected and measured corners [px]; large where something is not seen.
double median_error(const CameraModel& camera, const CameraPose& pose,
                    std::span<const PointObservation> observations) {
  const auto T_camera_board = pose.inverse();
  std::vector<double> errors;
  for (const PointObservation& o : observations) {
    const auto pixel = camera.project(T_camera_board * o.p_table);
    errors.push_back(pixel ? (*pixel - o.pixel).norm() : 1e6);
  }
  const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
  std::nth_element(errors.begin(), middle, errors.end());
  return *middle;
}

// A guess of the lens is as good as the poses that it allows.
struct Guess {
  CameraModel camera;
  double error_px = std::numeric_limits<double>::infinity();
};

std::vector<Guess> guess_lens(int width, int height, std::span<const Eigen::Vector3d> board,
                              std::span<const CalibrationView> views, DistortionModel model) {
  constexpr std::size_t kMostViews = 8;
  std::vector<std::vector<PointObservation>> chosen;
  const std::size_t step = std::max<std::size_t>(1, views.size() / kMostViews);
  for (std::size_t v = 0; v < views.size() && chosen.size() < kMostViews; v += step)
    chosen.push_back(observations_of(views[v], board));
  std::vector<Guess> guesses;
  const bool fisheye = model == DistortionModel::fisheye;
  for (const double k1 :
       fisheye ? std::vector<double>{0.0} : std::vector<double>{0.0, -0.15, -0.3}) {
    for (double f = 0.25; f < 5.0; f *= 1.2) {
      CameraParameters p;
      p.width = width;
      p.height = height;
      p.fx = p.fy = f * std::max(width, height);
      p.cx = 0.5 * (width - 1);
      p.cy = 0.5 * (height - 1);
      p.model = fisheye ? model : DistortionModel::plumb_bob;
      p.distortion[0] = k1;
      const Result<CameraModel> camera = CameraModel::make(p);
      if (!camera) continue;
      double sum = 0.0;
      for (const auto& observations : chosen) {
        double best = 1e4;
        for (const CameraPose& pose : solve_pose(*camera, observations))
          best = std::min(best, median_error(*camera, pose, observations));
        sum += std::min(best, 0.1 * width);
      }
      p.model = model;
      if (Result<CameraModel> start = CameraModel::make(p))
        guesses.push_back({*start, sum / static_cast<double>(chosen.size())});
    }
  }
  std::sort(guesses.begin(), guesses.end(),
            [](const Guess& a, const Guess& b) { return a.error_px < b.error_px; });
  return guesses;
}

std::optional<CameraPose> best_pose(const CameraModel& camera,
                                    std::span<const PointObservation> observations) {
  std::optional<CameraPose> best;
  double least = std::numeric_limits<double>::infinity();
  for (const CameraPose& pose : solve_pose(camera, observations)) {
    RefinerOptions options;
    options.robust_scale_px = 3.0;
    const auto refined = refine_pose(camera, observations, pose, options);
    const CameraPose& candidate = refined ? refined->T_table_camera : pose;
    const double error = median_error(camera, candidate, observations);
    if (error < least) {
      least = error;
      best = candidate;
    }
  }
  return best;
}

Result<CalibrationSolution> polish(Bundle& bundle, const SolverOptions& options,
                                   bool robust_first) {
  double noise = std::clamp(bundle.robust_noise(), 0.02, 2.0);
  const auto fails = [] {
    return fail("no camera explains the corners; is it the right target file, and one camera?");
  };
  if (robust_first) {
    if (!bundle.solve(8, false, true, noise, std::max(2.0 * noise, 0.5), options.max_iterations))
      return fails();
    noise = bundle.robust_noise();
  }
  for (int round = 0; round < 5; ++round) {
    const double limit = std::max(options.outlier_sigmas * noise, 0.02);
    const bool changed = options.remove_outliers && bundle.mark_outliers(limit);
    if (round > 0 && !changed) break;
    if (!bundle.solve(8, false, true, noise, 0.0, options.max_iterations)) return fails();
    noise = bundle.robust_noise();
    if (!options.remove_outliers) break;
  }
  return bundle.finish();
}

Result<void> check_views(std::span<const Eigen::Vector3d> board,
                         std::span<const CalibrationView> views) {
  if (views.size() < 3) {
    return fail(
        "{} usable views do not fix a camera; take at least 3, better 20, with the target "
        "tilted in several directions",
        views.size());
  }
  for (const CalibrationView& view : views) {
    if (view.corners.size() < 4)
      return fail("{}: has {} corners; 4 fix a pose", view.name, view.corners.size());
    for (const TargetCorner& corner : view.corners) {
      if (corner.point < 0 || static_cast<std::size_t>(corner.point) >= board.size() ||
          !corner.pixel.allFinite())
        return fail("{}: has a corner that is not on the target", view.name);
    }
  }
  return {};
}

}  // namespace

std::string_view to_string(BoardShape shape) {
  switch (shape) {
    case BoardShape::rigid:
      return "rigid";
    case BoardShape::bowed:
      return "bowed";
    case BoardShape::free:
      return "free";
  }
  return "rigid";
}

Result<CalibrationSolution> solve_intrinsics(int width, int height,
                                             std::span<const Eigen::Vector3d> board,
                                             std::span<const CalibrationView> views,
                                             const SolverOptions& options) {
  if (const auto ok = check_views(board, views); !ok) return tl::unexpected(ok.error());
  const std::vector<Guess> guesses = guess_lens(width, height, board, views, options.model);
  SolverOptions rough = options;
  rough.shape = BoardShape::rigid;
  std::optional<CalibrationSolution> best;
  double least = std::numeric_limits<double>::infinity();
  std::string why = "no start was found";
  int tried = 0;
  for (const Guess& guess : guesses) {
    if (tried == 4 || (tried > 0 && guess.error_px > 20.0 * guesses.front().error_px + 5.0)) break;
    ++tried;
    Bundle bundle(width, height, board, views, rough);
    bundle.lens = lens_of(guess.camera.parameters());
    bool posed = true;
    for (const CalibrationView& view : views) {
      const auto observations = observations_of(view, board);
      const auto pose = best_pose(guess.camera, observations);
      if (!pose) {
        posed = false;
        break;
      }
      bundle.poses.push_back(view_of(*pose, 0.0));
    }
    if (!posed) continue;
    const double loose = std::max(2.0, guess.error_px);
    // From few to many freedoms: far coefficients fitted to a bad start end in folds.
    if (!bundle.solve(1, true, false, 1.0, loose, 30)) continue;
    if (!bundle.solve(2, true, true, 1.0, loose, 50)) continue;
    Result<CalibrationSolution> solved = polish(bundle, rough, true);
    if (!solved) {
      why = solved.error().message;
      continue;
    }
    const double error =
        solved->noise_px * (1.0 + static_cast<double>(solved->outliers) / solved->corners);
    if (error < 0.98 * least) {
      least = error;
      best = std::move(*solved);
    }
  }
  if (!best) return fail("{}", why);
  if (options.shape == BoardShape::rigid) return *best;
  return solve_intrinsics(*best, board, views, options);
}

Result<CalibrationSolution> solve_intrinsics(const CalibrationSolution& start,
                                             std::span<const Eigen::Vector3d> board,
                                             std::span<const CalibrationView> views,
                                             const SolverOptions& options) {
  if (const auto ok = check_views(board, views); !ok) return tl::unexpected(ok.error());
  CameraParameters parameters = start.camera.parameters();
  Bundle bundle(parameters.width, parameters.height, board, views, options);
  if (parameters.model != options.model) {
    const bool from_fisheye = parameters.model == DistortionModel::fisheye;
    if (from_fisheye || options.model == DistortionModel::fisheye) {
      return solve_intrinsics(parameters.width, parameters.height, board, views, options);
    }
    parameters.model = options.model;
  }
  bundle.lens = lens_of(parameters);
  bundle.start_shape(start);
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (start.views.size() == views.size()) {
      bundle.poses.push_back(view_of(start.views[v].T_board_camera, start.views[v].edge_shift_px));
      continue;
    }
    const auto pose = best_pose(start.camera, observations_of(views[v], board));
    if (!pose) return fail("{}: no pose explains its corners", views[v].name);
    bundle.poses.push_back(view_of(*pose, 0.0));
  }
  return polish(bundle, options, true);
}

std::optional<double> pose_only_error(const CameraModel& camera,
                                      std::span<const Eigen::Vector3d> board,
                                      std::span<const CalibrationView> views) {
  double sum = 0.0;
  int count = 0;
  for (const CalibrationView& view : views) {
    const auto pose = best_pose(camera, observations_of(view, board));
    if (!pose) return std::nullopt;
    ViewParameters at = view_of(*pose, 0.0);
    LensParameters lens = lens_of(camera.parameters());
    ShapeParameters none{};
    ceres::Problem problem;
    bool shifts = false;
    for (const TargetCorner& corner : view.corners) {
      shifts = shifts || !corner.spread.isZero();
      problem.AddResidualBlock(
          new CornerFunction(new CornerCost{
              camera.parameters().model, board[static_cast<std::size_t>(corner.point)],
              Eigen::Vector3d::Zero(), false, corner.pixel, corner.spread}),
          nullptr, lens.data(), at.data(), none.data());
    }
    problem.SetParameterBlockConstant(lens.data());
    problem.SetParameterBlockConstant(none.data());
    if (!shifts) problem.SetManifold(at.data(), new ceres::SubsetManifold(kView, {6}));
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_QR;
    options.logging_type = ceres::SILENT;
    options.num_threads = 1;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    if (!summary.IsSolutionUsable()) return std::nullopt;
    sum += 2.0 * summary.final_cost;
    count += static_cast<int>(view.corners.size());
  }
  if (count == 0 || !std::isfinite(sum)) return std::nullopt;
  return std::sqrt(sum / count);
}

std::optional<double> held_out_error(const CalibrationSolution& solution,
                                     std::span<const Eigen::Vector3d> board,
                                     std::span<const CalibrationView> views,
                                     const SolverOptions& options, int folds) {
  const auto n = static_cast<int>(views.size());
  folds = std::min(folds, n);
  if (n < 4 || folds < 2) return std::nullopt;
  double sum = 0.0;
  double count = 0.0;
  for (int fold = 0; fold < folds; ++fold) {
    std::vector<CalibrationView> kept;
    std::vector<CalibrationView> left;
    CalibrationSolution start = solution;
    start.views.clear();
    for (int v = 0; v < n; ++v) {
      const auto i = static_cast<std::size_t>(v);
      if (v % folds == fold) {
        left.push_back(views[i]);
      } else {
        kept.push_back(views[i]);
        if (solution.views.size() == views.size()) start.views.push_back(solution.views[i]);
      }
    }
    const Result<CalibrationSolution> solved = solve_intrinsics(start, board, kept, options);
    if (!solved) return std::nullopt;
    const auto error = pose_only_error(solved->camera, solved->board, left);
    if (!error) return std::nullopt;
    double corners = 0.0;
    for (const CalibrationView& view : left) corners += static_cast<double>(view.corners.size());
    sum += *error * *error * corners;
    count += corners;
  }
  return std::sqrt(sum / count);
}

Eigen::MatrixXd lens_jacobian(const CameraModel& camera, const Eigen::Vector2d& xy) {
  const CameraParameters& p = camera.parameters();
  const int count = coefficient_count(p.model);
  using Jet = ceres::Jet<double, 8>;
  std::array<Jet, 8> k;
  for (int i = 0; i < 8; ++i) {
    k[static_cast<std::size_t>(i)] =
        i < count ? Jet(p.distortion[static_cast<std::size_t>(i)], i) : Jet(0.0);
  }
  Jet x_d;
  Jet y_d;
  distort<Jet>(p.model, k, Jet(xy.x()), Jet(xy.y()), x_d, y_d);
  Eigen::MatrixXd J = Eigen::MatrixXd::Zero(2, 4 + count);
  J(0, 0) = x_d.a;
  J(1, 1) = y_d.a;
  J(0, 2) = 1.0;
  J(1, 3) = 1.0;
  for (int i = 0; i < count; ++i) {
    J(0, 4 + i) = p.fx * x_d.v[i];
    J(1, 4 + i) = p.fy * y_d.v[i];
  }
  return J;
}

std::optional<Eigen::Matrix2d> projection_covariance(const CameraModel& camera,
                                                     const Eigen::MatrixXd& covariance,
                                                     const Eigen::Vector2d& pixel) {
  const auto direction = camera.unproject(pixel);
  if (!direction) return std::nullopt;
  const Eigen::MatrixXd J = lens_jacobian(camera, direction->head<2>());
  if (J.cols() != covariance.rows()) return std::nullopt;
  const Eigen::Matrix2d result = J * covariance * J.transpose();
  if (!result.allFinite()) return std::nullopt;
  return result;
}

double tilt_spread(std::span<const SolvedView> views) {
  double largest = 0.0;
  std::vector<Eigen::Vector3d> normals;  // in the camera's frame
  for (const SolvedView& view : views) {
    normals.emplace_back(view.T_board_camera.rotation().conjugate() * Eigen::Vector3d::UnitZ());
    for (const Eigen::Vector3d& other : normals)
      largest = std::max(largest, std::acos(std::clamp(normals.back().dot(other), -1.0, 1.0)));
  }
  return largest;
}

}  // namespace penumbra
