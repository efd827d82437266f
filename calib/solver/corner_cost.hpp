// Ceres cost functions of the calibration: corner residuals and priors.
#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <tuple>

#include "core/camera/camera_model.hpp"

namespace ceres {
class CostFunction;
}

namespace penumbra {

// Parameter blocks of corner_cost(), in this order.
using LensParameters = std::array<double, 12>;  // fx fy cx cy [px], coefficients
using ViewParameters = std::array<double, 7>;   // angle-axis [rad] and translation [m] of
                                                // T_camera_board, edge shift [px]
using ShapeParameters = std::array<double, 3>;  // the board's warp, or a point's offset [m]

inline constexpr int kLensSize = std::tuple_size_v<LensParameters>;
inline constexpr int kViewSize = std::tuple_size_v<ViewParameters>;
inline constexpr int kShapeSize = std::tuple_size_v<ShapeParameters>;

inline constexpr int kGrowthSamples = 8;
inline constexpr int kRationalPriorSize = 6 + 2 * kGrowthSamples;

struct CornerTerm {
  DistortionModel model = DistortionModel::plumb_bob;
  Eigen::Vector3d point = Eigen::Vector3d::Zero();   // on the board [m]
  Eigen::Vector3d warp = Eigen::Vector3d::Zero();    // x^2, y^2, x y; x, y in board radii
  bool bowed = false;                                // false: ShapeParameters is an offset
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();   // measured corner
  Eigen::Vector2d spread = Eigen::Vector2d::Zero();  // TargetCorner::spread
};

// Returns a cost with 2 residuals: projected - measured [px]. Evaluate() fails behind the camera.
[[nodiscard]] std::unique_ptr<ceres::CostFunction> corner_cost(const CornerTerm& term);
// Returns the prior of a view's edge shift (mean 0, sigma 1 px), for a block of ViewParameters.
[[nodiscard]] std::unique_ptr<ceres::CostFunction> edge_shift_prior();
// Returns the prior of a rational lens (docs/calibration.md#rational-lens), for LensParameters,
// with kRationalPriorSize residuals. Its argument: maximum radius of normalised coordinates.
[[nodiscard]] std::unique_ptr<ceres::CostFunction> rational_prior(double end);
// Returns the prior of a point's offset (mean 0), for ShapeParameters.
[[nodiscard]] std::unique_ptr<ceres::CostFunction> offset_prior(const Eigen::Vector3d& sigma_m);

}  // namespace penumbra
