// Simulated calibrations: corners of a flat target seen through a known lens from poses around it.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <random>
#include <vector>

#include "calib/solver/intrinsics_solver.hpp"
#include "core/camera/camera_model.hpp"
#include "support/cameras.hpp"

namespace penumbra::test {

// A wide-angle rational lens, close to an equidistant lens of 115 degrees across the image, with a
// little tangential distortion.
inline CameraModel rational_lens(int width = 640, int height = 480) {
  CameraParameters p;
  p.width = width;
  p.height = height;
  p.fx = 400.0 * width / 640.0;
  p.fy = 0.998 * p.fx;
  p.cx = 0.5 * width + 3.0;
  p.cy = 0.5 * height - 4.0;
  p.model = DistortionModel::rational;
  p.distortion = {0.7778, 0.0677, 0.0004, -0.0003, 0.001, 1.1111, 0.2381, 0.004};
  return CameraModel::make(p).value();
}

// An equidistant lens, 130 degrees across the image.
inline CameraModel wide_lens() {
  CameraParameters p;
  p.width = 640;
  p.height = 480;
  p.fx = 285.0;
  p.fy = 284.6;
  p.cx = 318.0;
  p.cy = 243.0;
  p.model = DistortionModel::fisheye;
  p.distortion = {-0.012, 0.004, -0.003, 0.0005};
  return CameraModel::make(p).value();
}

inline std::vector<Eigen::Vector3d> flat_board(int columns = 9, int rows = 7, double step = 0.03) {
  std::vector<Eigen::Vector3d> points;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i)
      points.emplace_back((i - 0.5 * (columns - 1)) * step, (0.5 * (rows - 1) - j) * step, 0.0);
  }
  return points;
}

struct ViewOptions {
  int views = 15;
  double noise_px = 0.1;
  double tilt_rad = 0.7;     // maximum tilt, in any direction
  double distance_m = 0.35;  // typical distance
  // 0: the board's centre lies up to 0.35 of the distance from the optical axis. Otherwise the
  // centre lies within this fraction of the image, and corners outside the fraction are not
  // observed.
  double coverage = 0.0;
};

// `shape`: true points of the board [m]. Views are redrawn until half of the target is in the
// image.
inline std::vector<CalibrationView> simulate_views(const CameraModel& camera,
                                                   const std::vector<Eigen::Vector3d>& shape,
                                                   const ViewOptions& options, std::mt19937& rng) {
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  std::normal_distribution<double> noise(0.0, options.noise_px);
  std::vector<CalibrationView> views;
  while (static_cast<int>(views.size()) < options.views) {
    // The board faces the camera, tilted about an axis in its plane and rotated about its normal.
    const double direction = M_PI * unit(rng);
    const Eigen::Quaterniond q =
        Eigen::AngleAxisd(options.tilt_rad * unit(rng),
                          Eigen::Vector3d(std::cos(direction), std::sin(direction), 0.0)) *
        Eigen::AngleAxisd(0.5 * unit(rng), Eigen::Vector3d::UnitZ()) *
        Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitX());
    const double z = options.distance_m * (1.0 + 0.3 * unit(rng));
    Eigen::Vector3d t(0.35 * z * unit(rng), 0.25 * z * unit(rng), z);
    const Eigen::Vector2d half(0.5 * camera.width(), 0.5 * camera.height());
    if (options.coverage > 0.0) {
      const Eigen::Vector2d off(unit(rng), unit(rng));
      const auto ray =
          camera.unproject(half + options.coverage * Eigen::Vector2d(off.cwiseProduct(half)));
      if (!ray) continue;
      t = z * ray->normalized();
    }
    const Transform<frame::Camera, frame::Table> T_camera_board(q, t);
    CalibrationView view;
    view.name = "view " + std::to_string(views.size());
    for (std::size_t i = 0; i < shape.size(); ++i) {
      const auto pixel = camera.project(T_camera_board * shape[i]);
      if (!pixel || pixel->x() < 3.0 || pixel->y() < 3.0 || pixel->x() > camera.width() - 4.0 ||
          pixel->y() > camera.height() - 4.0)
        continue;
      if (options.coverage > 0.0 &&
          (*pixel - half).cwiseQuotient(half).cwiseAbs().maxCoeff() > options.coverage + 0.1)
        continue;
      TargetCorner corner;
      corner.point = static_cast<int>(i);
      corner.pixel = *pixel + Eigen::Vector2d(noise(rng), noise(rng));
      view.corners.push_back(corner);
    }
    if (2 * view.corners.size() >= shape.size()) views.push_back(std::move(view));
  }
  return views;
}

}  // namespace penumbra::test
