// Bundle adjustment of lens, view poses and board shape. Marks outliers and computes the covariance
// of the lens.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "calib/solver/corner_cost.hpp"
#include "calib/solver/intrinsics_solver.hpp"

namespace penumbra {

[[nodiscard]] LensParameters lens_of(const CameraParameters& parameters);
void set_lens(CameraParameters& parameters, const LensParameters& lens);
[[nodiscard]] ViewParameters view_of(const CameraPose& T_board_camera, double edge_shift_px);

class Bundle {
 public:
  // Keeps references to `board` and `views`.
  Bundle(int width, int height, std::span<const Eigen::Vector3d> board,
         std::span<const CalibrationView> views, const SolverOptions& options);

  // Initial values, then the solution. The caller adds one pose per view.
  LensParameters lens{};
  std::vector<ViewParameters> poses;

  // Copies the points' offsets if both boards have the shape `free`.
  void start_shape(const CalibrationSolution& from);

  // `free_coefficients`: number of free coefficients. `move_centre`: frees the principal point.
  // `noise`: sigma per axis [px], weights the priors. `robust_px`: scale of the robust loss, or 0.
  bool solve(int free_coefficients, bool square_pixels, bool move_centre, double noise,
             double robust_px, int iterations);

  // Returns projected - measured corner [px], or nullopt if the point is behind the camera.
  [[nodiscard]] std::optional<Eigen::Vector2d> residual(std::size_t v, std::size_t c);

  // Returns the noise: sigma per axis [px]. The median 2-D normal distance is 1.1774 sigma.
  [[nodiscard]] double robust_noise() { return std::max(residual_quantile(0.5) / 1.1774, 1e-4); }
  // Returns a quantile of the corners' 2-D errors [px], without known outliers.
  [[nodiscard]] double residual_quantile(double fraction);

  // Returns true if the set of outliers changed. Keeps 4 or more corners per view. Does not change
  // views with known outliers.
  bool mark_outliers(double limit_px);

  // Computes the covariance of the lens from the normal equations with marginalised views
  // (docs/calibration.md#solver).
  [[nodiscard]] Result<CalibrationSolution> finish();

 private:
  [[nodiscard]] Eigen::Vector3d prior_sigma() const;
  // Returns the approximate maximum radius of normalised coordinates in the image.
  [[nodiscard]] double max_image_radius() const;
  // Returns the number of coefficients that are not fixed at 0.
  [[nodiscard]] int coefficients() const {
    return options_.without_k3 && options_.model == DistortionModel::plumb_bob
               ? 4
               : coefficient_count(options_.model);
  }
  [[nodiscard]] Eigen::Vector3d warp_of(const Eigen::Vector3d& p) const;
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
  std::vector<bool> has_edge_shift_;
};

}  // namespace penumbra
