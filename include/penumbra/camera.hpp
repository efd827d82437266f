// Camera models: camera frame <-> pixels. Camera frame: x right, y down, z forward (OpenCV, ROS).
// Pixel (0, 0) is the centre of the top left pixel.
#pragma once

#include <array>
#include <filesystem>
#include <memory>
#include <optional>
#include <penumbra/api.hpp>
#include <penumbra/types.hpp>
#include <string>
#include <vector>

namespace penumbra::types {

// With x = X / Z, y = Y / Z, r^2 = x^2 + y^2 and theta = atan(r), the pixel is
// (fx x_d + cx, fy y_d + cy). Coefficients of (x_d, y_d):
enum class DistortionModel {
  plumb_bob,  // k1 k2 p1 p2 k3 (Brown's model in OpenCV's order; ROS plumb_bob)
  rational,   // k1 k2 p1 p2 k3 k4 k5 k6 (OpenCV, ROS rational_polynomial)
  fisheye,    // k1 k2 k3 k4 of theta (Kannala and Brandt; OpenCV fisheye, ROS equidistant)
};

struct CameraParameters {
  int width = 0;              // [px]
  int height = 0;             // [px]
  double fx = 0.0, fy = 0.0;  // focal lengths [px]
  double cx = 0.0, cy = 0.0;  // principal point [px]
  DistortionModel model = DistortionModel::plumb_bob;
  std::array<double, 8> distortion{};  // unused coefficients are 0
  // Camera response (gamma exponent): linear light = (value / 255) ^ tone_curve.
  std::optional<double> tone_curve = {};
  // Time between the read-outs of two rows [s]; a global shutter has none.
  std::optional<double> rolling_shutter_row_s = {};
  // Overlay error (1 sigma) caused by the uncertainty of the lens [px].
  std::optional<double> overlay_sigma_px = {};
};

enum class CameraFileFormat { ros, opencv, kalibr };

// Immutable; copies are cheap and share their data. Threads may share a camera model.
class PENUMBRA_API CameraModel {
 public:
  // Throws if a size, focal length or coefficient is not finite or out of range.
  explicit CameraModel(const CameraParameters& parameters);
  // Reads camera_info YAML of ROS, YAML, JSON and XML of OpenCV, Kalibr's camchain.yaml and
  // mrcal's .cameramodel; the content determines the format. `name` selects one of several cameras.
  [[nodiscard]] static CameraModel load(const std::filesystem::path& file,
                                        const std::string& name = {});
  CameraModel(const CameraModel&);
  CameraModel& operator=(const CameraModel&);
  ~CameraModel();

  // Throws if the format can't represent the lens or the file can't be written.
  void save(const std::filesystem::path& file,
            CameraFileFormat format = CameraFileFormat::ros) const;

  [[nodiscard]] CameraParameters parameters() const;
  // Assumptions and implausible values of the loaded file, one line each.
  [[nodiscard]] const std::vector<std::string>& warnings() const;

  // Returns the pixel of a point in the camera frame [m], or nullopt if it is behind the camera
  // (Z <= 0), outside the range in which the distortion is monotonic, or not finite. The pixel may
  // lie outside the image.
  [[nodiscard]] std::optional<Vector2> project(const Vector3& p_camera) const;
  // Returns the direction (x, y, 1) in the camera frame that projects to the pixel, or nullopt.
  [[nodiscard]] std::optional<Vector3> unproject(const Vector2& pixel) const;

 private:
  friend struct Access;
  struct Impl;
  PENUMBRA_LOCAL explicit CameraModel(std::shared_ptr<const Impl> impl);
  std::shared_ptr<const Impl> impl_;
};

}  // namespace penumbra::types
