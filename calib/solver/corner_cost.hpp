// The terms of the calibration's bundle adjustment, as cost functions of Ceres: a corner of a
// target seen in a view, and the priors.
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

// The blocks that are solved for, in the order in which a corner's term takes them.
using LensParameters = std::array<double, 12>;  // fx fy cx cy [px], coefficients
using ViewParameters = std::array<double, 7>;   // angle-axis [rad] and translation [m] of
                                                // T_camera_board, edge shift [px]
using ShapeParameters = std::array<double, 3>;  // the board's bow, or a point's own offset [m]

inline constexpr int kLensSize = std::tuple_size_v<LensParameters>;
inline constexpr int kViewSize = std::tuple_size_v<ViewParameters>;
inline constexpr int kShapeSize = std::tuple_size_v<ShapeParameters>;

inline constexpr int kGrowthSamples = 8;
inline constexpr int kRationalPriorSize = 6 + 2 * kGrowthSamples;

struct CornerTerm {
  DistortionModel model = DistortionModel::plumb_bob;
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // on the board [m]
  Eigen::Vector3d bow = Eigen::Vector3d::Zero();    // x^2, y^2, x y; what the shape's numbers scale
  bool bowed = false;                               // else the shape is an offset
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();  // as measured
  Eigen::Vector2d spread = Eigen::Vector2d::Zero();  // where the edge shift moves it
};

// Residual: (projected - measured) [px], 2. Its evaluation fails behind the camera.
[[nodiscard]] std::unique_ptr<ceres::CostFunction> corner_cost(const CornerTerm& term);
// Holds a view's edge shift near 0, by a sigma of 1 px. Takes the view's block.
[[nodiscard]] std::unique_ptr<ceres::CostFunction> edge_shift_prior();
// Holds a rational lens to what lenses do, where no corner says it; `end` is the radius of
// normalised coordinates up to which the image reaches. Takes the lens' block; kRationalPriorSize
// residuals.
[[nodiscard]] std::unique_ptr<ceres::CostFunction> rational_prior(double end);
// Holds a point's offset near 0, by a sigma for each axis. Takes a shape's block.
[[nodiscard]] std::unique_ptr<ceres::CostFunction> offset_prior(const Eigen::Vector3d& sigma_m);

}  // namespace penumbra
