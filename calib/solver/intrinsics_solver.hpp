// Estimates a camera model from corners in several views of one target: bundle adjustment of lens,
// view poses and (optionally) board shape. See docs/calibration.md#solver for the covariance.
//
// Residuals are (projected - measured) corners [px]. The order of lens parameters is fx fy cx cy,
// then the coefficients of core/camera/camera_model.hpp.
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
#include "core/text/enum_names.hpp"

namespace penumbra {

struct CalibrationView {
  std::string name;  // for messages
  std::vector<TargetCorner> corners;
  std::vector<bool> outlier = {};  // known outliers; if empty, the solver finds them

  [[nodiscard]] bool counts(std::size_t corner) const {
    return outlier.empty() || !outlier[corner];
  }
};

// Model of the board's deviation from the target file (docs/calibration.md#board-warp).
enum class BoardShape {
  rigid,  // none
  bowed,  // z = a x^2 + b y^2 + c x y
  free,   // an offset of each point, with a prior (Strobl and Hirzinger, More accurate pinhole
         // camera calibration with imperfect planar target, ICCV workshops 2011, without the prior)
};
inline constexpr auto kBoardShapeNames = std::to_array<EnumName<BoardShape>>(
    {{BoardShape::rigid, "rigid"}, {BoardShape::bowed, "bowed"}, {BoardShape::free, "free"}});
[[nodiscard]] constexpr std::string_view to_string(BoardShape shape) {
  return name_of(kBoardShapeNames, shape);
}

struct SolverOptions {
  DistortionModel model = DistortionModel::plumb_bob;
  BoardShape shape = BoardShape::rigid;
  bool without_k3 = false;  // plumb_bob with k3 = 0, Kalibr's radtan
  std::stop_token stop;     // once requested, solving fails soon with "ended early"
};

// Minimum distance of an outlier, in units of Bundle::robust_noise().
inline constexpr double kOutlierSigmas = 4.5;

struct SolvedView {
  CameraPose T_board_camera;
  double edge_shift_px = 0.0;                 // outward shift of the black squares' edges
  std::vector<Eigen::Vector2d> residuals_px;  // one per corner
  std::vector<bool> outlier;
  double rms_px = 0.0;  // 2-D error, without outliers
};

struct CalibrationSolution {
  CameraModel camera;
  BoardShape shape = BoardShape::rigid;
  std::vector<Eigen::Vector3d> board;  // refined points [m]
  std::vector<SolvedView> views;
  // Covariance of the lens parameters (4 + coefficient_count rows), scaled by noise_px^2 and
  // covariance_inflation.
  Eigen::MatrixXd covariance;
  double noise_px = 0.0;              // sigma per axis, without outliers
  double rms_px = 0.0;                // 2-D error, without outliers
  double rms_all_px = 0.0;            // 2-D error, with outliers
  double covariance_inflation = 1.0;  // factor for correlated residuals of a view
  int corners = 0;
  int outliers = 0;

  // Returns false if another lens model may fit better.
  [[nodiscard]] bool explains_corners() const {
    return noise_px <= 0.5 && outliers * 20 <= corners;
  }
  // Returns true if the corners are not those of the target, or not of one camera.
  [[nodiscard]] bool contradicts_corners() const {
    return noise_px > 3.0 || outliers * 2 > corners;
  }
};

// Solves without an initial lens; supports wide lenses. `width`, `height`: image size [px]. The
// error is one line that explains what the views lack.
[[nodiscard]] Result<CalibrationSolution> solve_intrinsics(int width, int height,
                                                           std::span<const Eigen::Vector3d> board,
                                                           std::span<const CalibrationView> views,
                                                           const SolverOptions& options = {});

// Solves from a nearby solution of any model and shape; additional parameters start at 0.
[[nodiscard]] Result<CalibrationSolution> solve_intrinsics(const CalibrationSolution& start,
                                                           std::span<const Eigen::Vector3d> board,
                                                           std::span<const CalibrationView> views,
                                                           const SolverOptions& options = {});

// Sum of the squared 2-D errors of a view's corners, without outliers.
struct ViewError {
  double squared_px2 = 0.0;
  int corners = 0;
};
[[nodiscard]] double rms_of(std::span<const ViewError> errors);  // 2-D error [px]

// Runs a 5-fold cross-validation that starts from `solution`. Returns each view's error with the
// lens solved from the other folds, where only the view's pose is fitted. Returns nullopt for fewer
// than 4 views or if a fold can't be solved.
[[nodiscard]] std::optional<std::vector<ViewError>> held_out_errors(
    const CalibrationSolution& solution, std::span<const Eigen::Vector3d> board,
    std::span<const CalibrationView> views, const SolverOptions& options);

// Returns the errors of `views` for a fixed camera and board; fits only the poses.
[[nodiscard]] std::optional<std::vector<ViewError>> pose_only_errors(
    const CameraModel& camera, std::span<const Eigen::Vector3d> board,
    std::span<const CalibrationView> views);

// Returns the covariance of the projection at `pixel` [px^2] caused by the covariance of the lens
// parameters, or nullopt if the pixel has no ray.
[[nodiscard]] std::optional<Eigen::Matrix2d> projection_covariance(
    const CameraModel& camera, const Eigen::MatrixXd& covariance, const Eigen::Vector2d& pixel);

// Returns d pixel / d lens parameters for a direction (x, y, 1): 2 x (4 + coefficient_count).
[[nodiscard]] Eigen::MatrixXd lens_jacobian(const CameraModel& camera, const Eigen::Vector2d& xy);

// Returns the maximum angle between the board normals of two views [rad]. Tilt is needed to
// separate focal length and distance.
[[nodiscard]] double tilt_spread(std::span<const SolvedView> views);

}  // namespace penumbra
