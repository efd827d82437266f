// Estimates a camera model from corners in several views of one target: bundle adjustment over the
// lens, the views' poses and (if asked) the board's shape. Its covariance:
// docs/calibration.md#solver.
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
  std::string name;  // for messages
  std::vector<TargetCorner> corners;
  std::vector<bool> outlier = {};  // known outliers; empty: the solver finds them

  [[nodiscard]] bool counts(std::size_t corner) const {
    return outlier.empty() || !outlier[corner];
  }
};

// The board's deviation from the target file (docs/calibration.md#board-warp).
enum class BoardShape {
  rigid,  // none
  bowed,  // z = a x^2 + b y^2 + c x y
  free,   // an offset of each point, with a prior (Strobl and Hirzinger, More accurate pinhole
         // camera calibration with imperfect planar target, ICCV workshops 2011, without the prior)
};
[[nodiscard]] std::string_view to_string(BoardShape shape);  // "rigid", "bowed", "free"

struct SolverOptions {
  DistortionModel model = DistortionModel::plumb_bob;
  BoardShape shape = BoardShape::rigid;
  bool without_k3 = false;  // plumb_bob: k3 stays 0, as Kalibr's radtan has it
  std::stop_token stop;     // once requested, solving fails soon: "ended early"
};

// An outlier's distance over the spread of one axis, which the median gives.
inline constexpr double kOutlierSigmas = 4.5;

struct SolvedView {
  CameraPose T_board_camera;
  double edge_shift_px = 0.0;                 // outward shift of black squares' edges
  std::vector<Eigen::Vector2d> residuals_px;  // one per corner
  std::vector<bool> outlier;
  double rms_px = 0.0;  // of 2-D distances, without outliers
};

struct CalibrationSolution {
  CameraModel camera;
  BoardShape shape = BoardShape::rigid;
  std::vector<Eigen::Vector3d> board;  // refined points [m]
  std::vector<SolvedView> views;
  // Covariance of the lens parameters, 4 + coefficient_count rows, scaled by noise_px^2 and
  // clustering.
  Eigen::MatrixXd covariance;
  double noise_px = 0.0;    // one axis, without outliers
  double rms_px = 0.0;      // 2-D distance, without outliers
  double rms_all_px = 0.0;  // with outliers
  double clustering = 1.0;  // covariance inflation for correlated residuals of a view
  int corners = 0;
  int outliers = 0;
};

// Solves without an initial lens, also for wide lenses. `width` and `height` are the images' [px].
// An error says in one line what the views lack.
[[nodiscard]] Result<CalibrationSolution> solve_intrinsics(int width, int height,
                                                           std::span<const Eigen::Vector3d> board,
                                                           std::span<const CalibrationView> views,
                                                           const SolverOptions& options = {});

// Solves from a solution near by, of any model and shape: additional parameters start at zero.
[[nodiscard]] Result<CalibrationSolution> solve_intrinsics(const CalibrationSolution& start,
                                                           std::span<const Eigen::Vector3d> board,
                                                           std::span<const CalibrationView> views,
                                                           const SolverOptions& options = {});

// Squared distances [px^2] of a view's corners, without outliers.
struct ViewError {
  double squared_px2 = 0.0;
  int corners = 0;
};
[[nodiscard]] double rms_of(std::span<const ViewError> errors);  // of 2-D distances [px]

// Cross-validation: errors of views that took no part in the solution, by view. Solves without each
// fifth of the views (from `solution`) and fits their poses only. Nothing for fewer than 4 views or
// if a part can't be solved.
[[nodiscard]] std::optional<std::vector<ViewError>> held_out_errors(
    const CalibrationSolution& solution, std::span<const Eigen::Vector3d> board,
    std::span<const CalibrationView> views, const SolverOptions& options);

// Errors of `views` with fitted poses, for a fixed camera and board.
[[nodiscard]] std::optional<std::vector<ViewError>> pose_only_errors(
    const CameraModel& camera, std::span<const Eigen::Vector3d> board,
    std::span<const CalibrationView> views);

// Covariance [px^2] of the projection at `pixel` due to the covariance of the lens parameters;
// nothing if the lens does not reach the pixel.
[[nodiscard]] std::optional<Eigen::Matrix2d> projection_covariance(
    const CameraModel& camera, const Eigen::MatrixXd& covariance, const Eigen::Vector2d& pixel);

// d pixel / d lens parameters for a direction (x, y, 1): 2 x (4 + coefficient_count).
[[nodiscard]] Eigen::MatrixXd lens_jacobian(const CameraModel& camera, const Eigen::Vector2d& xy);

// Largest angle between any two views' board normals [rad]: it separates focal length from
// distance.
[[nodiscard]] double tilt_spread(std::span<const SolvedView> views);

}  // namespace penumbra
