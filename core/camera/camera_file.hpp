// Camera models in files.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"

namespace penumbra {

// Which format a file has is decided by what it holds, never by its name or first line:
// - ROS camera_info YAML: image_width, image_height, camera_matrix.data, distortion_model (or
//   camera_model), distortion_coefficients.data; optional tone_curve, rolling_shutter_row_s,
//   uncertainty.overlay_px (or uncertainty.table_volume.tracked_px, of which it is the RMS). Other
//   keys are ignored (also the flat fx: ... of some recordings: camera_matrix wins), but those by
//   which an optional one may be meant: two letters off, or without its unit.
// - A ROS message as `ros2 topic echo` and `rostopic echo` print it: width, height, k, d (or K, D).
// - OpenCV FileStorage YAML, JSON and XML: camera_matrix and distortion_coefficients (also as
//   Camera_Matrix, cameraMatrix, ...), image_width, image_height or image_size; fisheye_model: 1;
//   optional tone_curve, rolling_shutter_row_s, uncertainty. Of two cameras: M1 and D1, M2 and D2.
// - Kalibr camchain YAML: cameras of any name with pinhole, radtan or equidistant or none.
// - mrcal .cameramodel: LENSMODEL_PINHOLE, LENSMODEL_OPENCV4, 5 and 8.
// ROS and OpenCV files have 0, 4, 5, 8, 12 or 14 coefficients: those that are missing are 0, those
// beyond the model's must be 0. Errors name file and field. An unknown lens model is refused by
// name.
struct LoadedCamera {
  CameraModel camera;
  // Assumptions and implausible values: one line each, with the file's name.
  std::vector<std::string> warnings;
};
// `name`: which camera of a file that holds several; empty: the only one. Fails, with the names
// that the file has, where there are several and none is named, or not this one.
[[nodiscard]] Result<LoadedCamera> load_camera_file(const std::filesystem::path& file,
                                                    const std::string& name = {});
// The only camera of a file, without the warnings.
[[nodiscard]] Result<CameraModel> load_camera(const std::filesystem::path& file);

enum class CameraFileFormat { ros, opencv, kalibr };

// How a camera was calibrated: extra keys that readers of ROS and OpenCV files ignore.
struct CalibrationRecord {
  std::string calibrated_on;  // "2026-03-01"
  std::string target;         // what was looked at
  int views = 0;
  double rms_px = 0.0;                 // 2-D distance
  std::optional<double> held_out_px;   // of views that took no part
  double projection_mean_px = 0.0;     // 1 sigma, over the image
  double projection_largest_px = 0.0;  // 1 sigma, at the worst place
  // 1 sigma at the corners of the overlay cube (core/evaluation/evaluation.hpp), seen from
  // `table_distance_m`: its pose known, and its pose found with this lens. Empty where nothing is
  // known of it.
  std::vector<double> table_known_pose_px;
  std::vector<double> table_tracked_px;
  double table_distance_m = 0.0;
  std::vector<double> standard_deviations;  // fx fy cx cy k1 ...
  std::optional<double> focus_position;
  std::optional<double> tone_curve_sigma;  // of the camera's tone_curve
};

// Fails for a lens that the format can't say: Kalibr has no rational model, and no k3.
[[nodiscard]] Result<void> save_camera(const std::filesystem::path& file, const CameraModel& camera,
                                       CameraFileFormat format = CameraFileFormat::ros,
                                       const CalibrationRecord* record = nullptr);
// What save_camera() writes as ROS camera_info.
[[nodiscard]] std::string ros_camera_text(const CameraModel& camera);

// The same camera where n x n pixels are taken together (binned), or the other way round: the pixel
// p of the larger picture lies at (p + 0.5) / n - 0.5 of the smaller one, the lens is the same.
// Exact if both sizes show the same view. Fails where the sizes are not whole multiples, by one
// number in width and height. What a row takes to be read is not known at the other size.
[[nodiscard]] Result<CameraModel> scaled_to(const CameraModel& camera, int width, int height);

}  // namespace penumbra
