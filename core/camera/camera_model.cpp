#include "core/camera/camera_model.hpp"

#include <Eigen/LU>
#include <limits>
#include <utility>

namespace penumbra {
namespace {

// Returns the distorted radius for the undistorted radius `r`, without the tangential terms.
double radial_profile(const CameraParameters& p, double r) {
  const std::array<double, 8>& k = p.distortion;
  switch (p.model) {
    case DistortionModel::fisheye: {
      const double t = std::atan(r);
      const double t2 = t * t;
      return t * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    }
    case DistortionModel::plumb_bob:
    case DistortionModel::rational:
      break;
  }
  const double r2 = r * r;
  const double numerator = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  const double denominator =
      p.model == DistortionModel::rational ? 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])) : 1.0;
  return r * numerator / denominator;
}

Eigen::Vector2d distorted(const CameraParameters& p, const Eigen::Vector2d& xy) {
  Eigen::Vector2d result;
  distort<double>(p.model, p.distortion, xy.x(), xy.y(), result.x(), result.y());
  return result;
}

// Returns the smallest radius at which the profile stops growing, by a scan over the angle from the
// optical axis and bisection.
double find_max_radius(const CameraParameters& p) {
  constexpr int kSteps = 4096;
  constexpr double kLargestAngle = 1.57;  // just below pi/2, the limit of a pinhole camera
  const auto grows = [&](double r) {
    const double step = 1e-6 * (1.0 + r);
    return radial_profile(p, r + step) > radial_profile(p, r);
  };
  double previous = 0.0;
  for (int i = 1; i <= kSteps; ++i) {
    const double r = std::tan(kLargestAngle * i / kSteps);
    if (!grows(r)) {
      double low = previous;
      double high = r;
      for (int j = 0; j < 60; ++j) {
        const double middle = 0.5 * (low + high);
        (grows(middle) ? low : high) = middle;
      }
      return low;
    }
    previous = r;
  }
  return std::numeric_limits<double>::infinity();
}

}  // namespace

std::string coefficient_name(DistortionModel model, std::size_t index) {
  constexpr std::array<const char*, 8> kPolynomial = {"k1", "k2", "p1", "p2",
                                                      "k3", "k4", "k5", "k6"};
  return is_polynomial(model) ? kPolynomial[index] : fmt::format("k{}", index + 1);
}

Result<CameraModel> CameraModel::make(const CameraParameters& parameters) {
  const CameraParameters& p = parameters;
  constexpr int kLargestSide = 32768;
  if (p.width < 1 || p.width > kLargestSide) {
    return fail("image_width is {}; give the image's width in pixels (1 to {})", p.width,
                kLargestSide);
  }
  if (p.height < 1 || p.height > kLargestSide) {
    return fail("image_height is {}; give the image's height in pixels (1 to {})", p.height,
                kLargestSide);
  }
  for (const auto& [name, f] : {std::pair("fx", p.fx), std::pair("fy", p.fy)}) {
    if (!(f > 1e-3 && f < 1e7))
      return fail("focal length {} is {}; it must be a positive number of pixels", name, f);
  }
  for (const auto& [name, c] : {std::pair("cx", p.cx), std::pair("cy", p.cy)}) {
    if (!(std::abs(c) <= 1e6))
      return fail("principal point {} is {}; it must be a number of pixels", name, c);
  }
  for (std::size_t i = 0; i < p.distortion.size(); ++i) {
    if (!(std::abs(p.distortion[i]) <= 1e6)) {
      return fail("distortion coefficient {} is {}; it must be a finite number",
                  coefficient_name(p.model, i), p.distortion[i]);
    }
  }
  if (p.tone_curve && !(*p.tone_curve >= 0.1 && *p.tone_curve <= 10.0))
    return fail("tone_curve is {}; it must be an exponent between 0.1 and 10", *p.tone_curve);
  if (p.rolling_shutter_row_s) {
    const double row_s = *p.rolling_shutter_row_s;
    constexpr double kMaxReadout_s = 0.2;  // slow cameras need 1/30 s or more
    if (!(row_s >= 0.0 && row_s < 1.0)) {
      return fail(
          "rolling_shutter_row_s is {}; it must be the seconds from one row to the next, from 0 to "
          "{:g}",
          row_s, kMaxReadout_s / p.height);
    }
    if (row_s * p.height > kMaxReadout_s) {
      return fail(
          "rolling_shutter_row_s is {}: {} rows then take {:.3g} s, longer than any camera; it "
          "must be the seconds from one row to the next",
          row_s, p.height, row_s * p.height);
    }
  }
  if (p.overlay_sigma_px && !(*p.overlay_sigma_px >= 0.0 && *p.overlay_sigma_px <= 1e6)) {
    return fail("uncertainty: overlay_px is {}; it must be a number of pixels from 0 to 1e6",
                *p.overlay_sigma_px);
  }

  CameraModel camera;
  camera.parameters_ = parameters;
  for (auto i = static_cast<std::size_t>(coefficient_count(parameters.model)); i < 8; ++i)
    camera.parameters_.distortion[i] = 0.0;
  camera.has_distortion_ = !is_polynomial(parameters.model);  // even with all coefficients 0
  for (const double k : camera.parameters_.distortion)
    camera.has_distortion_ = camera.has_distortion_ || k != 0.0;
  camera.max_radius_ = camera.has_distortion_ ? find_max_radius(camera.parameters_)
                                              : std::numeric_limits<double>::infinity();
  return camera;
}

std::optional<Eigen::Vector2d> CameraModel::project(const Eigen::Vector3d& p_camera) const {
  if (!p_camera.allFinite() || p_camera.z() <= 0.0) return std::nullopt;
  if (std::hypot(p_camera.x() / p_camera.z(), p_camera.y() / p_camera.z()) > max_radius_)
    return std::nullopt;
  const Eigen::Vector2d pixel = project_unchecked(p_camera);
  if (!pixel.allFinite()) return std::nullopt;
  return pixel;
}

std::optional<Eigen::Vector2d> CameraModel::project_extended(
    const Eigen::Vector3d& p_camera) const {
  if (!p_camera.allFinite() || p_camera.z() <= 0.0) return std::nullopt;
  const double r = std::hypot(p_camera.x() / p_camera.z(), p_camera.y() / p_camera.z());
  if (!(r > max_radius_)) return project(p_camera);
  // The profile's derivative is 0 at max_radius, so the extension uses the slope of the chord
  // from 0. `edge` is not checked: rounding may put it just beyond max_radius.
  const double scale = max_radius_ / r;
  const Eigen::Vector2d edge =
      project_unchecked({p_camera.x() * scale, p_camera.y() * scale, p_camera.z()});
  const Eigen::Vector2d centre(parameters_.cx, parameters_.cy);
  const Eigen::Vector2d pixel = centre + (edge - centre) / scale;
  if (!pixel.allFinite()) return std::nullopt;
  return pixel;
}

Eigen::Vector2d CameraModel::project_unchecked(const Eigen::Vector3d& p_camera,
                                               Eigen::Matrix<double, 2, 3>* jacobian) const {
  const double inverse_z = 1.0 / p_camera.z();
  const Eigen::Vector2d xy = p_camera.head<2>() * inverse_z;
  const Eigen::Vector2d xy_d = has_distortion_ ? distorted(parameters_, xy) : xy;
  if (jacobian != nullptr) {
    Eigen::Matrix<double, 2, 3> J_normalise;
    J_normalise << inverse_z, 0.0, -xy.x() * inverse_z, 0.0, inverse_z, -xy.y() * inverse_z;
    *jacobian = Eigen::Vector2d(parameters_.fx, parameters_.fy).asDiagonal() *
                distortion_jacobian(xy) * J_normalise;
  }
  return {parameters_.fx * xy_d.x() + parameters_.cx, parameters_.fy * xy_d.y() + parameters_.cy};
}

Eigen::Matrix2d CameraModel::distortion_jacobian(const Eigen::Vector2d& xy) const {
  if (!has_distortion_) return Eigen::Matrix2d::Identity();
  const std::array<double, 8>& k = parameters_.distortion;
  const double x = xy.x();
  const double y = xy.y();
  const double r2 = x * x + y * y;
  Eigen::Matrix2d J;
  switch (parameters_.model) {
    case DistortionModel::fisheye: {
      if (r2 < 1e-16) return Eigen::Matrix2d::Identity();
      const double r = std::sqrt(r2);
      const double t = std::atan(r);
      const double t2 = t * t;
      const double theta_d = t * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
      const double dtheta_d =
          1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])));
      const double scale = theta_d / r;
      const double dscale_over_r = (dtheta_d / (1.0 + r2) - scale) / r2;  // (d scale / d r) / r
      J << scale + dscale_over_r * x * x, dscale_over_r * x * y, dscale_over_r * x * y,
          scale + dscale_over_r * y * y;
      return J;
    }
    case DistortionModel::plumb_bob:
    case DistortionModel::rational:
      break;
  }
  double radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  double dradial = k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4]);  // d radial / d r2
  if (parameters_.model == DistortionModel::rational) {
    const double denominator = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]));
    const double ddenominator = k[5] + r2 * (2.0 * k[6] + r2 * 3.0 * k[7]);
    dradial = (dradial * denominator - radial * ddenominator) / (denominator * denominator);
    radial /= denominator;
  }
  const double p1 = k[2];
  const double p2 = k[3];
  J(0, 0) = radial + 2.0 * x * x * dradial + 2.0 * p1 * y + 6.0 * p2 * x;
  J(0, 1) = 2.0 * x * y * dradial + 2.0 * p1 * x + 2.0 * p2 * y;
  J(1, 0) = 2.0 * x * y * dradial + 2.0 * p1 * x + 2.0 * p2 * y;
  J(1, 1) = radial + 2.0 * y * y * dradial + 6.0 * p1 * y + 2.0 * p2 * x;
  return J;
}

std::optional<Eigen::Vector3d> CameraModel::unproject(const Eigen::Vector2d& pixel) const {
  if (!pixel.allFinite()) return std::nullopt;
  const Eigen::Vector2d target((pixel.x() - parameters_.cx) / parameters_.fx,
                               (pixel.y() - parameters_.cy) / parameters_.fy);
  if (!has_distortion_) return Eigen::Vector3d(target.x(), target.y(), 1.0);
  // Bisection on the radial profile, which is monotonic up to max_radius, then Newton steps for the
  // tangential part.
  const double target_radius = target.norm();
  double low = 0.0;
  double high = std::isfinite(max_radius_) ? max_radius_ : 1.0;
  if (!std::isfinite(max_radius_)) {
    while (radial_profile(parameters_, high) < target_radius && high < 1e6) high *= 2.0;
  }
  for (int i = 0; i < 20; ++i) {
    const double middle = 0.5 * (low + high);
    (radial_profile(parameters_, middle) < target_radius ? low : high) = middle;
  }
  Eigen::Vector2d xy = target_radius > 0.0
                           ? Eigen::Vector2d(target * (0.5 * (low + high) / target_radius))
                           : Eigen::Vector2d(0.0, 0.0);
  for (int i = 0; i < 30; ++i) {
    const Eigen::Vector2d residual = distorted(parameters_, xy) - target;
    if (residual.squaredNorm() < 1e-28) break;
    const Eigen::Matrix2d J = distortion_jacobian(xy);
    if (std::abs(J.determinant()) < 1e-12) break;
    const Eigen::Vector2d step = J.inverse() * residual;
    xy -= step;
    if (!xy.allFinite()) return std::nullopt;
    if (step.squaredNorm() < 1e-30) break;
  }
  if (xy.norm() > max_radius_ * (1.0 + 1e-9)) return std::nullopt;
  if ((distorted(parameters_, xy) - target).norm() > 1e-9 * (1.0 + target_radius))
    return std::nullopt;
  return Eigen::Vector3d(xy.x(), xy.y(), 1.0);
}

}  // namespace penumbra
