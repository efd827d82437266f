// Bundle adjustment of a calibration: the lens, every view's pose and the board's shape, what they
// are measured by, and what the solution is worth.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "calib/solver/corner_cost.hpp"
#include "calib/solver/intrinsics_solver.hpp"

namespace penumbra {

[[nodiscard]] LensParameters lens_of(const CameraParameters& parameters);
[[nodiscard]] ViewParameters view_of(const CameraPose& T_board_camera, double edge_shift_px);

class Bundle {
 public:
  // Keeps `board` and `views`, whose corners are points of the board.
  Bundle(int width, int height, std::span<const Eigen::Vector3d> board,
         std::span<const CalibrationView> views, const SolverOptions& options);

  // Where solving begins and what it found; the caller gives one pose per view.
  LensParameters lens{};
  std::vector<ViewParameters> poses;

  // The points' offsets, where both boards are free.
  void start_shape(const CalibrationSolution& from);

  // `free_coefficients`: how many of k1, k2, ... may move; `noise`: of one axis, weighs the priors
  // [px]; `robust_px`: scale of the loss, 0 for none.
  bool solve(int free_coefficients, bool square_pixels, bool move_centre, double noise,
             double robust_px, int iterations);

  // (projected - measured) of a corner [px]; nothing behind the camera.
  [[nodiscard]] std::optional<Eigen::Vector2d> residual(std::size_t v, std::size_t c);

  // Spread of one axis [px] by the median of distances (that of a 2-D normal is 1.1774 sigma).
  [[nodiscard]] double robust_noise() { return std::max(distance_at(0.5) / 1.1774, 1e-4); }
  // So large a share of the corners is nearer than this [px]; those known to be wrong left out.
  [[nodiscard]] double distance_at(double share);

  // Whether the choice of outliers changed. Never takes so many of a view that no pose is left, and
  // leaves views alone whose outliers are known.
  bool mark_outliers(double limit_px);

  // Normal equations, views eliminated, and from them the covariance of the lens.
  [[nodiscard]] Result<CalibrationSolution> finish();

 private:
  [[nodiscard]] Eigen::Vector3d prior_sigma() const;
  // Radius of normalised coordinates up to which the image reaches, about.
  [[nodiscard]] double image_end() const;
  // Coefficients of the lens that may be other than 0: the first ones.
  [[nodiscard]] int coefficients() const {
    return options_.without_k3 && options_.model == DistortionModel::plumb_bob
               ? 4
               : coefficient_count(options_.model);
  }
  [[nodiscard]] Eigen::Vector3d bow_of(const Eigen::Vector3d& p) const;
  [[nodiscard]] CornerTerm term_of(const TargetCorner& corner) const;
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

}  // namespace penumbra
