// Corners in several views of one target -> camera model: bundle adjustment over the lens, every
// view's pose and (where asked) the board's shape, and what the result is worth.
//
// Residuals are (projected - measured) corners [px]. Lens parameters are, in this order, fx fy cx
// cy and the coefficients of core/camera/camera_model.hpp.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "calib/target/target_detector.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

struct CalibrationView {
  std::string name;  // what messages call it
  std::vector<TargetCorner> corners;
  // Corners known to be wrong, which count for nothing. Empty: the solver finds them.
  std::vector<bool> outlier = {};

  [[nodiscard]] bool counts(std::size_t corner) const {
    return outlier.empty() || !outlier[corner];
  }
};

// What the board may be other than flat and true.
enum class BoardShape {
  rigid,  // as the target's file says
  bowed,  // z = a x^2 + b y^2 + c x y
  free,   // every point has an offset of its own, held by a prior, tighter in the plane than out of
         // it (Strobl and Hirzinger, More accurate pinhole camera calibration with imperfect planar
         // target, ICCV workshops 2011, without a prior)
};
[[nodiscard]] std::string_view to_string(BoardShape shape);  // "rigid", "bowed", "free"

struct SolverOptions {
  DistortionModel model = DistortionModel::plumb_bob;
  BoardShape shape = BoardShape::rigid;
  bool without_k3 = false;  // plumb_bob: k3 stays 0, as Kalibr's radtan has it
  bool remove_outliers = true;
  // Corners are outliers beyond so many times the spread of one axis, found by the median.
  double outlier_sigmas = 4.5;
  // Sigma of a point's offset out of the board's plane; in the plane a tenth of it. 0: 1/500 of the
  // board's radius.
  double free_prior_m = 0.0;
  int max_iterations = 100;
  std::stop_token stop;  // once requested, what solves fails soon: "ended early"
};

struct SolvedView {
  CameraPose T_board_camera;
  double edge_shift_px = 0.0;                 // by which black squares look larger in this view
  std::vector<Eigen::Vector2d> residuals_px;  // one per corner
  std::vector<bool> outlier;
  double rms_px = 0.0;  // of 2-D distances, outliers left out
};

struct CalibrationSolution {
  CameraModel camera;
  BoardShape shape = BoardShape::rigid;
  std::vector<Eigen::Vector3d> board;  // points as refined [m]
  std::vector<SolvedView> views;
  // Of the lens parameters, 4 + coefficient_count rows. Scaled by the residuals' own spread, and
  // by how much residuals of one view hang together.
  Eigen::MatrixXd covariance;
  double noise_px = 0.0;    // one axis, outliers left out
  double rms_px = 0.0;      // 2-D distance, outliers left out
  double rms_all_px = 0.0;  // with outliers
  double clustering = 1.0;  // factor by which the covariance was raised
  int corners = 0;
  int outliers = 0;
};

// Without a start: the lens is guessed from the views themselves, wide ones too. `width` and
// `height` are the pictures' [px]. An error says in one line what the views lack.
[[nodiscard]] Result<CalibrationSolution> solve_intrinsics(int width, int height,
                                                           std::span<const Eigen::Vector3d> board,
                                                           std::span<const CalibrationView> views,
                                                           const SolverOptions& options = {});

// From a solution near by (of any model and shape: what it lacks starts at zero).
[[nodiscard]] Result<CalibrationSolution> solve_intrinsics(const CalibrationSolution& start,
                                                           std::span<const Eigen::Vector3d> board,
                                                           std::span<const CalibrationView> views,
                                                           const SolverOptions& options = {});

// Squared distances [px^2] of a view's corners, outliers left out.
struct ViewError {
  double squared_px2 = 0.0;
  int corners = 0;
};
[[nodiscard]] double rms_of(std::span<const ViewError> errors);  // of 2-D distances [px]

// How far the corners of views are off that took no part in the solution, view by view: `folds`
// times a share of the views is left out, the rest solved (from `solution`), and only poses fitted
// to those left out. Nothing for fewer than 4 views or where a part can't be solved.
[[nodiscard]] std::optional<std::vector<ViewError>> held_out_errors(
    const CalibrationSolution& solution, std::span<const Eigen::Vector3d> board,
    std::span<const CalibrationView> views, const SolverOptions& options, int folds = 5);

// Of all those views together: RMS [px].
[[nodiscard]] std::optional<double> held_out_error(const CalibrationSolution& solution,
                                                   std::span<const Eigen::Vector3d> board,
                                                   std::span<const CalibrationView> views,
                                                   const SolverOptions& options, int folds = 5);

// The corners of `views` with camera and board as they are, poses fitted.
[[nodiscard]] std::optional<std::vector<ViewError>> pose_only_errors(
    const CameraModel& camera, std::span<const Eigen::Vector3d> board,
    std::span<const CalibrationView> views);
[[nodiscard]] std::optional<double> pose_only_error(const CameraModel& camera,
                                                    std::span<const Eigen::Vector3d> board,
                                                    std::span<const CalibrationView> views);

// Covariance [px^2] of where `camera` projects what lies in the direction that `pixel` shows: what
// the lens parameters' covariance does to that pixel. Nothing where the lens reaches no such pixel.
[[nodiscard]] std::optional<Eigen::Matrix2d> projection_covariance(
    const CameraModel& camera, const Eigen::MatrixXd& covariance, const Eigen::Vector2d& pixel);

// d pixel / d lens parameters for a direction (x, y, 1): 2 x (4 + coefficient_count).
[[nodiscard]] Eigen::MatrixXd lens_jacobian(const CameraModel& camera, const Eigen::Vector2d& xy);

// Largest angle between any two views' board normals [rad]: what separates focal length from
// distance.
[[nodiscard]] double tilt_spread(std::span<const SolvedView> views);

}  // namespace penumbra
