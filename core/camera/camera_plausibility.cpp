#include "core/camera/camera_plausibility.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "core/text/text.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

std::optional<std::string> outside_image(const char* field, double value, const char* dimension,
                                         int size_px) {
  if (value > 0.0 && value < size_px) return std::nullopt;
  return fmt::format(
      "{} is {:g}, outside the image, whose {} is {} px; is the calibration of another image size?",
      field, value, dimension, size_px);
}

// Returns the horizontal field of view of the lens without its distortion [deg].
double undistorted_field_of_view_deg(const CameraParameters& p) {
  const double half_width = 0.5 * p.width / p.fx;
  return degrees(2.0 * (p.model == DistortionModel::fisheye ? half_width : std::atan(half_width)));
}

std::optional<std::string> implausible_focal_length(const CameraParameters& p) {
  constexpr double kLargestRatio = 2.0;  // reached by cameras that skip every other row or column
  if (p.fx > kLargestRatio * p.fy || p.fy > kLargestRatio * p.fx) {
    return fmt::format(
        "fy is {:g} and fx is {:g}, but pixels are nearly square; is one of them mistyped, or the "
        "order of the numbers another?",
        p.fy, p.fx);
  }
  const double field_of_view_deg = undistorted_field_of_view_deg(p);
  const bool fisheye = p.model == DistortionModel::fisheye;
  if (field_of_view_deg > (fisheye ? 360.0 : 170.0)) {
    return fmt::format(
        "fx is {:g} px in an image {} px wide, a field of view of {:.0f} degrees; is it in "
        "millimetres, or is the calibration of a smaller image?",
        p.fx, p.width, field_of_view_deg);
  }
  if (field_of_view_deg < 1.0) {
    return fmt::format(
        "fx is {:g} px in an image {} px wide, a field of view of {:.2g} degrees; is a decimal "
        "point missing, or is the calibration of a larger image?",
        p.fx, p.width, field_of_view_deg);
  }
  return std::nullopt;
}

// Ignores the image's corners, where the distortion of wide lenses is often non-monotonic.
std::optional<std::string> non_monotonic_inside(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const double limit_px = monotonic_radius_px(camera);
  if (limit_px >= 0.5 * std::min(p.width, p.height)) return std::nullopt;
  const std::span coefficients(p.distortion.data(),
                               static_cast<std::size_t>(coefficient_count(p.model)));
  return fmt::format(
      "distortion coefficients: [{}] of {} are non-monotonic from {:.0f} px off the principal "
      "point on, in an image of {} x {} px; is a sign wrong, or are they of another distortion "
      "model?",
      joined(coefficients), to_string(p.model), limit_px, p.width, p.height);
}

}  // namespace

double monotonic_radius_px(const CameraModel& camera) {
  if (!std::isfinite(camera.max_radius())) return std::numeric_limits<double>::infinity();
  // The factor keeps rounding errors from exceeding max_radius().
  const auto limit = camera.project({camera.max_radius() * (1.0 - 1e-9), 0.0, 1.0});
  const Eigen::Vector2d centre(camera.parameters().cx, camera.parameters().cy);
  return limit ? (*limit - centre).norm() : 0.0;
}

std::optional<std::string> implausible_parameter(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  if (auto text = outside_image("cx", p.cx, "width", p.width)) return text;
  if (auto text = outside_image("cy", p.cy, "height", p.height)) return text;
  if (auto text = implausible_focal_length(p)) return text;
  return non_monotonic_inside(camera);
}

}  // namespace penumbra
