// Pinhole camera with lens distortion: camera frame (x right, y down, z forward) <-> pixels.
// Pixel (0, 0) is the centre of the top-left pixel (OpenCV, ROS).
//
//   x = X / Z,  y = Y / Z,  (x_d, y_d) = distort(x, y),  u = fx x_d + cx,  v = fy y_d + cy
//
// plumb_bob (coefficients k1 k2 p1 p2 k3, OpenCV's order):
//
//   r2  = x^2 + y^2
//   d   = 1 + k1 r2 + k2 r2^2 + k3 r2^3
//   x_d = d x + 2 p1 x y + p2 (r2 + 2 x^2)
//   y_d = d y + p1 (r2 + 2 y^2) + 2 p2 x y
//
// rational (k1 k2 p1 p2 k3 k4 k5 k6): plumb_bob's formulas with
//
//   d = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
//
// fisheye (k1 k2 k3 k4; Kannala and Brandt, ROS "equidistant", OpenCV fisheye):
//
//   theta      = atan(sqrt(r2))
//   theta_d    = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
//   (x_d, y_d) = theta_d / sqrt(r2) (x, y)
#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// A switch over the models has no default, so that the compiler warns where a new model is missing.
enum class DistortionModel { plumb_bob, rational, fisheye };
inline constexpr std::array kDistortionModels = {
    DistortionModel::plumb_bob, DistortionModel::rational, DistortionModel::fisheye};

struct DistortionTraits {
  std::string_view name;        // as in ROS
  std::string_view short_name;  // value of `penumbra calibrate --model`
  int coefficients = 0;
  bool is_polynomial = false;  // the first coefficients are k1 k2 p1 p2 k3
};
[[nodiscard]] constexpr DistortionTraits traits_of(DistortionModel model) {
  switch (model) {
    case DistortionModel::plumb_bob:
      return {"plumb_bob", "plumb_bob", 5, true};
    case DistortionModel::rational:
      return {"rational_polynomial", "rational", 8, true};
    case DistortionModel::fisheye:
      return {"equidistant", "fisheye", 4, false};
  }
  return {};
}
static_assert(static_cast<std::size_t>(kDistortionModels.back()) + 1 == kDistortionModels.size() &&
                  traits_of(DistortionModel{kDistortionModels.size()}).coefficients == 0,
              "kDistortionModels lists all models in the order of the enum");

[[nodiscard]] constexpr std::string_view to_string(DistortionModel model) {
  return traits_of(model).name;
}
[[nodiscard]] constexpr std::string_view short_name(DistortionModel model) {
  return traits_of(model).short_name;
}
[[nodiscard]] constexpr int coefficient_count(DistortionModel model) {
  return traits_of(model).coefficients;
}
[[nodiscard]] constexpr bool is_polynomial(DistortionModel model) {
  return traits_of(model).is_polynomial;
}
// Returns "k1", "p1", ...
[[nodiscard]] std::string coefficient_name(DistortionModel model, std::size_t index);

struct CameraParameters {
  int width = 0;              // [px]
  int height = 0;             // [px]
  double fx = 0.0, fy = 0.0;  // [px]
  double cx = 0.0, cy = 0.0;  // [px]
  DistortionModel model = DistortionModel::plumb_bob;
  std::array<double, 8> distortion{};  // unused ones are 0
  std::string name;
  // Camera response (gamma exponent): linear light = (value / 255) ^ tone_curve.
  std::optional<double> tone_curve;
  std::optional<double> rolling_shutter_row_s;  // [s] between the read-outs of two rows
  // Overlay error (1 sigma, core/evaluation/evaluation.hpp) caused by the lens uncertainty [px],
  // for poses that were estimated with this lens.
  std::optional<double> overlay_sigma_px;
};

// Distorts normalised image coordinates. T: double or ceres::Jet. K: double or T.
template <class T, class K>
void distort(DistortionModel model, const std::array<K, 8>& k, const T& x, const T& y, T& x_d,
             T& y_d) {
  using std::atan2;
  using std::sqrt;
  const T r2 = x * x + y * y;
  switch (model) {
    case DistortionModel::fisheye: {
      if (r2 < T(1e-16)) {  // theta_d / r -> 1
        x_d = x;
        y_d = y;
        return;
      }
      const T r = sqrt(r2);
      const T theta = atan2(r, T(1.0));
      const T t2 = theta * theta;
      const T scale =
          theta * (T(1.0) + t2 * (T(k[0]) + t2 * (T(k[1]) + t2 * (T(k[2]) + t2 * T(k[3]))))) / r;
      x_d = scale * x;
      y_d = scale * y;
      return;
    }
    case DistortionModel::plumb_bob:
    case DistortionModel::rational:
      [[likely]] break;  // without the attribute this path spills registers to the stack
  }
  T radial = T(1.0) + r2 * (T(k[0]) + r2 * (T(k[1]) + r2 * T(k[4])));
  if (model == DistortionModel::rational) {
    radial = radial / (T(1.0) + r2 * (T(k[5]) + r2 * (T(k[6]) + r2 * T(k[7]))));
  }
  const T p1(k[2]);
  const T p2(k[3]);
  const T xy2 = T(2.0) * x * y;
  x_d = x * radial + p1 * xy2 + p2 * (r2 + T(2.0) * x * x);
  y_d = y * radial + p1 * (r2 + T(2.0) * y * y) + p2 * xy2;
}

class CameraModel {
 public:
  // Fails if a size, focal length or coefficient is not finite or out of range; the error names it.
  [[nodiscard]] static Result<CameraModel> make(const CameraParameters& parameters);

  [[nodiscard]] const CameraParameters& parameters() const { return parameters_; }
  [[nodiscard]] int width() const { return parameters_.width; }
  [[nodiscard]] int height() const { return parameters_.height; }
  [[nodiscard]] bool has_distortion() const { return has_distortion_; }
  // Largest radius hypot(x, y) of normalised coordinates up to which the distorted radius grows.
  // Beyond it the distortion is non-monotonic. Infinite if it is monotonic everywhere.
  [[nodiscard]] double max_radius() const { return max_radius_; }

  // Returns the pixel of a point in the camera frame [m], or nullopt if the point is behind the
  // camera (Z <= 0), beyond max_radius or not finite. The pixel may lie outside the image.
  [[nodiscard]] std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& p_camera) const;
  // Like project(), but continues linearly along the radius beyond max_radius, so that drawn shapes
  // stay connected. Returns nullopt behind the camera.
  [[nodiscard]] std::optional<Eigen::Vector2d> project_extended(
      const Eigen::Vector3d& p_camera) const;
  // Like project() without checks; Z must not be 0. Sets `jacobian`, if given: d pixel / d
  // p_camera.
  [[nodiscard]] Eigen::Vector2d project_unchecked(
      const Eigen::Vector3d& p_camera, Eigen::Matrix<double, 2, 3>* jacobian = nullptr) const;

  // Returns the direction (x, y, 1) in the camera frame that projects to `pixel`, or nullopt.
  [[nodiscard]] std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& pixel) const;

  // d distorted / d undistorted normalised coordinates (2x2).
  [[nodiscard]] Eigen::Matrix2d distortion_jacobian(const Eigen::Vector2d& xy) const;

 private:
  CameraParameters parameters_;
  bool has_distortion_ = false;
  double max_radius_ = 0.0;
};

}  // namespace penumbra
