#include "calib/solver/intrinsics_solver.hpp"

#include <ceres/ceres.h>

#include <Eigen/QR>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "calib/solver/bundle.hpp"
#include "core/propagate.hpp"
#include "core/statistics.hpp"
#include "tracking/detection/pose_refiner.hpp"
#include "tracking/detection/pose_solver.hpp"

namespace penumbra {
namespace {

std::vector<PointObservation> observations_of(const CalibrationView& view,
                                              std::span<const Eigen::Vector3d> board) {
  std::vector<PointObservation> observations;
  for (std::size_t c = 0; c < view.corners.size(); ++c) {
    const TargetCorner& corner = view.corners[c];
    if (view.counts(c))
      observations.push_back({board[static_cast<std::size_t>(corner.point)], corner.pixel});
  }
  return observations;
}

// Returns the median distance of projected and measured corners [px].
double median_error(const CameraModel& camera, const MapFromCamera& pose,
                    std::span<const PointObservation> observations) {
  const auto T_camera_board = pose.inverse();
  std::vector<double> errors;
  for (const PointObservation& o : observations) {
    const auto pixel = camera.project(T_camera_board * o.p_map);
    errors.push_back(pixel ? (*pixel - o.pixel).norm() : 1e6);
  }
  return upper_median(std::move(errors));
}

struct Guess {
  CameraModel camera;
  double error_px = std::numeric_limits<double>::infinity();  // mean error of a pose by this lens
};

std::vector<Guess> guess_lens(int width, int height, std::span<const Eigen::Vector3d> board,
                              std::span<const CalibrationView> views,
                              const SolverOptions& options) {
  const DistortionModel model = options.model;
  constexpr std::size_t kMaxViews = 8;
  std::vector<std::vector<PointObservation>> chosen;
  const std::size_t step = std::max<std::size_t>(1, views.size() / kMaxViews);
  for (std::size_t v = 0; v < views.size() && chosen.size() < kMaxViews; v += step)
    chosen.push_back(observations_of(views[v], board));
  std::vector<Guess> guesses;
  const bool polynomial = is_polynomial(model);
  for (const double k1 :
       polynomial ? std::vector<double>{0.0, -0.15, -0.3} : std::vector<double>{0.0}) {
    for (double f = 0.25; f < 5.0 && !options.stop.stop_requested(); f *= 1.2) {
      CameraParameters p;
      p.width = width;
      p.height = height;
      p.fx = p.fy = f * std::max(width, height);
      p.cx = 0.5 * (width - 1);
      p.cy = 0.5 * (height - 1);
      p.model = polynomial ? DistortionModel::plumb_bob : model;
      p.distortion[0] = k1;
      const Result<CameraModel> camera = CameraModel::make(p);
      if (!camera) continue;
      double sum = 0.0;
      for (const auto& observations : chosen) {
        double best = 1e4;
        for (const MapFromCamera& pose : solve_pose(*camera, observations))
          best = std::min(best, median_error(*camera, pose, observations));
        sum += std::min(best, 0.1 * width);
      }
      p.model = model;
      if (Result<CameraModel> start = CameraModel::make(p))
        guesses.push_back({*start, sum / static_cast<double>(chosen.size())});
    }
  }
  std::ranges::sort(guesses, {}, &Guess::error_px);
  return guesses;
}

std::optional<CameraPose> best_pose(const CameraModel& camera,
                                    std::span<const PointObservation> observations) {
  std::optional<CameraPose> best;
  double min_error = std::numeric_limits<double>::infinity();
  for (const MapFromCamera& pose : solve_pose(camera, observations)) {
    RefinerOptions options;
    options.robust_scale_px = 3.0;
    const auto refined = refine_pose(camera, observations, pose, options);
    const MapFromCamera& candidate = refined ? refined->T_map_camera : pose;
    const double error = median_error(camera, candidate, observations);
    if (error < min_error) {
      min_error = error;
      best = as_table_pose(candidate);
    }
  }
  return best;
}

constexpr int kMaxIterations = 100;
constexpr double kMaxRobustScale_px = 20.0;  // maximum scale of the first robust loss

std::vector<std::size_t> radial_coefficients(DistortionModel model) {
  switch (model) {
    case DistortionModel::plumb_bob:
      return {0, 1, 4};
    case DistortionModel::rational:
      return {0, 1, 4, 5, 6, 7};
    case DistortionModel::fisheye:
      return {0, 1, 2, 3};
  }
  return {};
}

// Fits the coefficients of another model to a lens. Returns nullopt if the distortion is
// non-monotonic near the centre.
std::optional<CameraParameters> as_model(const CameraModel& camera, DistortionModel model) {
  const CameraParameters& from = camera.parameters();
  const auto end = camera.unproject(Eigen::Vector2d(0.0, 0.0));
  constexpr double kMaxTan = 4.0;  // tangent of the maximum angle from the axis
  const double furthest = std::min(
      {end ? end->head<2>().norm() : kMaxTan,
       std::isfinite(camera.max_radius()) ? 0.98 * camera.max_radius() : kMaxTan, kMaxTan});
  if (!(furthest > 0.05)) return std::nullopt;
  constexpr int kSamples = 48;
  const std::vector<std::size_t> indices = radial_coefficients(model);
  const auto n = static_cast<Eigen::Index>(indices.size());
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(kSamples + n, n);
  Eigen::VectorXd b = Eigen::VectorXd::Zero(kSamples + n);
  std::array<double, 8> radial = from.distortion;
  if (is_polynomial(from.model)) radial[2] = radial[3] = 0.0;
  for (int i = 0; i < kSamples; ++i) {
    const double r = furthest * (i + 1) / kSamples;
    double distorted_x = 0.0;
    double distorted_y = 0.0;
    distort(from.model, radial, r, 0.0, distorted_x, distorted_y);
    const double base = model == DistortionModel::fisheye ? std::atan(r) : r;
    double power = 1.0;
    for (Eigen::Index k = 0; k < n; ++k) {
      if (k == 3 && model == DistortionModel::rational) power = 1.0;
      power *= base * base;
      A(i, k) = k >= 3 && model == DistortionModel::rational ? -distorted_x * power : base * power;
    }
    b[i] = distorted_x - base;
  }
  // A weak prior at 0, because several solutions fit almost equally.
  for (Eigen::Index k = 0; k < n; ++k) A(kSamples + k, k) = 1e-4;
  const Eigen::VectorXd solved = A.householderQr().solve(b);
  if (!solved.allFinite()) return std::nullopt;
  CameraParameters to = from;
  to.model = model;
  to.distortion = {};
  if (is_polynomial(from.model) && is_polynomial(model)) {
    to.distortion[2] = from.distortion[2];
    to.distortion[3] = from.distortion[3];
  }
  for (Eigen::Index k = 0; k < n; ++k)
    to.distortion[indices[static_cast<std::size_t>(k)]] = solved[k];
  return to;
}

tl::unexpected<Error> ended_early() {
  return fail("ended early");
}

Result<CalibrationSolution> polish(Bundle& bundle, const SolverOptions& options,
                                   bool robust_first) {
  double noise = std::clamp(bundle.robust_noise(), 0.02, 2.0);
  const auto fails = [&options] {
    if (options.stop.stop_requested()) return ended_early();
    return fail("no camera explains the corners; is it the right target file, and one camera?");
  };
  if (robust_first) {
    const double scale = std::max(2.0 * noise, 0.5);
    // Handles large errors far from the centre, which a start with fewer coefficients has.
    const double far = std::min(bundle.residual_quantile(0.95), kMaxRobustScale_px);
    if (far > 2.0 * scale && !bundle.solve(8, false, true, noise, far, kMaxIterations))
      return fails();
    if (!bundle.solve(8, false, true, noise, scale, kMaxIterations)) return fails();
    noise = bundle.robust_noise();
  }
  for (int round = 0; round < 5; ++round) {
    const bool changed = bundle.mark_outliers(std::max(kOutlierSigmas * noise, 0.02));
    if (round > 0 && !changed) break;
    if (!bundle.solve(8, false, true, noise, 0.0, kMaxIterations)) return fails();
    noise = bundle.robust_noise();
  }
  return bundle.finish();
}

Result<void> check_views(std::span<const Eigen::Vector3d> board,
                         std::span<const CalibrationView> views) {
  if (views.size() < 3) {
    return fail(
        "{} usable views do not determine a camera; take at least 3, better 20, with the target "
        "tilted in several directions",
        views.size());
  }
  for (const CalibrationView& view : views) {
    if (!view.outlier.empty() && view.outlier.size() != view.corners.size())
      return fail("{}: has {} corners, but {} marks", view.name, view.corners.size(),
                  view.outlier.size());
    if (view.corners.size() < 4)
      return fail("{}: has {} corners; a pose needs 4", view.name, view.corners.size());
    for (const TargetCorner& corner : view.corners) {
      if (corner.point < 0 || static_cast<std::size_t>(corner.point) >= board.size() ||
          !corner.pixel.allFinite())
        return fail("{}: has a corner that is not on the target", view.name);
    }
  }
  return {};
}

}  // namespace

Result<CalibrationSolution> solve_intrinsics(int width, int height,
                                             std::span<const Eigen::Vector3d> board,
                                             std::span<const CalibrationView> views,
                                             const SolverOptions& options) {
  PENUMBRA_TRY_VOID(check_views(board, views));
  const std::vector<Guess> guesses = guess_lens(width, height, board, views, options);
  SolverOptions rough = options;
  rough.shape = BoardShape::rigid;
  std::optional<CalibrationSolution> best;
  double min_error = std::numeric_limits<double>::infinity();
  std::string why = "no lens explains the corners; is it the right target file, and one camera?";
  int tried = 0;
  for (const Guess& guess : guesses) {
    if (options.stop.stop_requested()) return ended_early();
    if (tried == 4 || (tried > 0 && guess.error_px > 20.0 * guesses.front().error_px + 5.0)) break;
    ++tried;
    Bundle bundle(width, height, board, views, rough);
    bundle.lens = lens_of(guess.camera.parameters());
    bool posed = true;
    for (const CalibrationView& view : views) {
      const auto observations = observations_of(view, board);
      const auto pose = best_pose(guess.camera, observations);
      if (!pose || options.stop.stop_requested()) {
        posed = false;
        break;
      }
      bundle.poses.push_back(view_of(*pose, 0.0));
    }
    if (!posed) continue;
    const double loose = std::max(2.0, guess.error_px);
    // Adds parameters step by step: from a bad start, higher coefficients become non-monotonic.
    if (!bundle.solve(1, true, false, 1.0, loose, 30)) continue;
    if (!bundle.solve(2, true, true, 1.0, loose, 50)) continue;
    Result<CalibrationSolution> solved = polish(bundle, rough, true);
    if (!solved) {
      why = solved.error().message;
      continue;
    }
    const double error =
        solved->noise_px * (1.0 + static_cast<double>(solved->outliers) / solved->corners);
    if (error < 0.98 * min_error) {
      min_error = error;
      best = std::move(*solved);
    }
  }
  if (options.stop.stop_requested()) return ended_early();
  if (!best) return fail("{}", why);
  if (options.shape == BoardShape::rigid) return *best;
  return solve_intrinsics(*best, board, views, options);
}

Result<CalibrationSolution> solve_intrinsics(const CalibrationSolution& start,
                                             std::span<const Eigen::Vector3d> board,
                                             std::span<const CalibrationView> views,
                                             const SolverOptions& options) {
  PENUMBRA_TRY_VOID(check_views(board, views));
  CameraParameters parameters = start.camera.parameters();
  Bundle bundle(parameters.width, parameters.height, board, views, options);
  if (parameters.model != options.model) {
    if (!is_polynomial(parameters.model) || !is_polynomial(options.model)) {
      const auto alike =
          start.explains_corners() ? as_model(start.camera, options.model) : std::nullopt;
      if (!alike)
        return solve_intrinsics(parameters.width, parameters.height, board, views, options);
      parameters = *alike;
    }
    parameters.model = options.model;
  }
  if (options.without_k3 && options.model == DistortionModel::plumb_bob)
    parameters.distortion[4] = 0.0;
  bundle.lens = lens_of(parameters);
  bundle.start_shape(start);
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (start.views.size() == views.size()) {
      bundle.poses.push_back(view_of(start.views[v].T_board_camera, start.views[v].edge_shift_px));
      continue;
    }
    const auto pose = best_pose(start.camera, observations_of(views[v], board));
    if (!pose) return fail("{}: no pose explains its corners", views[v].name);
    if (options.stop.stop_requested()) return ended_early();
    bundle.poses.push_back(view_of(*pose, 0.0));
  }
  const bool known =
      std::ranges::all_of(views, [](const auto& view) { return !view.outlier.empty(); });
  return polish(bundle, options, !known);
}

double rms_of(std::span<const ViewError> errors) {
  double sum = 0.0;
  int count = 0;
  for (const ViewError& error : errors) {
    sum += error.squared_px2;
    count += error.corners;
  }
  return std::sqrt(sum / count);
}

std::optional<std::vector<ViewError>> pose_only_errors(const CameraModel& camera,
                                                       std::span<const Eigen::Vector3d> board,
                                                       std::span<const CalibrationView> views) {
  std::vector<ViewError> errors;
  for (const CalibrationView& view : views) {
    const auto pose = best_pose(camera, observations_of(view, board));
    if (!pose) return std::nullopt;
    ViewParameters at = view_of(*pose, 0.0);
    LensParameters lens = lens_of(camera.parameters());
    ShapeParameters none{};
    ceres::Problem problem;
    bool shifts = false;
    int count = 0;
    for (std::size_t c = 0; c < view.corners.size(); ++c) {
      if (!view.counts(c)) continue;
      const TargetCorner& corner = view.corners[c];
      shifts = shifts || !corner.spread.isZero();
      ++count;
      problem.AddResidualBlock(
          corner_cost({camera.parameters().model, board[static_cast<std::size_t>(corner.point)],
                       Eigen::Vector3d::Zero(), false, corner.pixel, corner.spread})
              .release(),
          nullptr, lens.data(), at.data(), none.data());
    }
    problem.SetParameterBlockConstant(lens.data());
    problem.SetParameterBlockConstant(none.data());
    if (!shifts)
      problem.SetManifold(at.data(), new ceres::SubsetManifold(static_cast<int>(at.size()), {6}));
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_QR;
    options.logging_type = ceres::SILENT;
    options.num_threads = 1;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    if (!summary.IsSolutionUsable()) return std::nullopt;
    const double squared = 2.0 * summary.final_cost;
    if (!std::isfinite(squared)) return std::nullopt;
    errors.push_back({squared, count});
  }
  return errors;
}

std::optional<std::vector<ViewError>> held_out_errors(const CalibrationSolution& solution,
                                                      std::span<const Eigen::Vector3d> board,
                                                      std::span<const CalibrationView> views,
                                                      const SolverOptions& options) {
  constexpr std::size_t kFolds = 5;
  const std::size_t n = views.size();
  const std::size_t folds = std::min(kFolds, n);
  if (n < 4) return std::nullopt;
  std::vector<ViewError> errors(n);
  for (std::size_t fold = 0; fold < folds; ++fold) {
    std::vector<CalibrationView> kept;
    std::vector<CalibrationView> held_out;
    CalibrationSolution start = solution;
    start.views.clear();
    for (std::size_t v = 0; v < n; ++v) {
      if (v % folds == fold) {
        held_out.push_back(views[v]);
      } else {
        kept.push_back(views[v]);
        if (solution.views.size() == n) start.views.push_back(solution.views[v]);
      }
    }
    const Result<CalibrationSolution> solved = solve_intrinsics(start, board, kept, options);
    if (!solved) return std::nullopt;
    const auto found = pose_only_errors(solved->camera, solved->board, held_out);
    if (!found) return std::nullopt;
    for (std::size_t i = 0; i < found->size(); ++i) errors[fold + i * folds] = (*found)[i];
  }
  return errors;
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
