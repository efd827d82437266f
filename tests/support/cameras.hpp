// Cameras for tests.
#pragma once

#include <optional>

#include "core/camera/camera_model.hpp"

namespace penumbra::test {

// Returns a camera of 640 x 480 px without distortion. `overlay_sigma_px`: uncertainty of its lens.
inline CameraModel pinhole_camera(std::optional<double> overlay_sigma_px = std::nullopt) {
  CameraParameters p;
  p.width = 640;
  p.height = 480;
  p.fx = p.fy = 500.0;
  p.cx = 320.0;
  p.cy = 240.0;
  p.overlay_sigma_px = overlay_sigma_px;
  return CameraModel::make(p).value();
}

// A webcam of 640 x 480 px with typical distortion.
inline CameraModel desk_camera() {
  CameraParameters p;
  p.width = 640;
  p.height = 480;
  p.fx = 531.7;
  p.fy = 530.4;
  p.cx = 322.3;
  p.cy = 237.6;
  p.distortion = {-0.215, 0.062, 0.0008, -0.0006, -0.004};
  return CameraModel::make(p).value();
}

// Returns desk_camera() with a lens of this model.
inline CameraModel lens_of(DistortionModel model) {
  CameraParameters p = desk_camera().parameters();
  p.model = model;
  switch (model) {
    case DistortionModel::plumb_bob:
      break;
    case DistortionModel::rational:
      p.distortion = {0.5, -0.1, 0.001, -0.0005, 0.02, 0.8, -0.05, 0.03};
      break;
    case DistortionModel::fisheye:
      p.distortion = {-0.02, 0.004, -0.001, 0.0002};
      break;
  }
  return CameraModel::make(p).value();
}

}  // namespace penumbra::test
