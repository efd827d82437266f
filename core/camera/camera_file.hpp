// Camera models in files.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"

namespace penumbra {

// The content decides which format a file has, never its name or first line:
// - ROS camera_info YAML: image_width, image_height, camera_matrix.data, distortion_model (or
//   camera_model), distortion_coefficients.data; optional tone_curve, rolling_shutter_row_s,
//   uncertainty.overlay_px (or uncertainty.table_volume.tracked_px, whose RMS it is). Other keys
//   are ignored (also the flat fx: ... of some recordings: camera_matrix wins), except misspelt
//   optional ones: YamlFields::has_optional().
// - A ROS message as `ros2 topic echo` and `rostopic echo` print it: width, height, k, d (or K, D).
// - OpenCV FileStorage YAML, JSON and XML: camera_matrix and distortion_coefficients (also as
//   Camera_Matrix, cameraMatrix, ...), image_width, image_height or image_size; fisheye_model: 1;
//   optional tone_curve, rolling_shutter_row_s, uncertainty. Of two cameras: M1 and D1, M2 and D2.
// - Kalibr camchain YAML: cameras of any name with pinhole, radtan or equidistant or none.
// - mrcal .cameramodel: LENSMODEL_PINHOLE, LENSMODEL_OPENCV4, 5 and 8.
// ROS and OpenCV files have 0, 4, 5, 8, 12 or 14 coefficients: missing ones are 0, and those beyond
// the model's must be 0. Errors name file and field.
struct LoadedCamera {
  CameraModel camera;
  // Assumptions and implausible values: one line each, with the file's name.
  std::vector<std::string> warnings;
};
// `name` chooses a camera of a file that holds several; empty: the only one. The error lists the
// file's names.
[[nodiscard]] Result<LoadedCamera> load_camera_file(const std::filesystem::path& file,
                                                    const std::string& name = {});
// The only camera of a file, without the warnings.
[[nodiscard]] Result<CameraModel> load_camera(const std::filesystem::path& file);

enum class CameraFileFormat { ros, opencv, kalibr };
[[nodiscard]] std::string_view to_string(CameraFileFormat format);  // "ROS", "OpenCV", "Kalibr"
// A lens model's name in files of the format, or its value of OpenCV's key fisheye_model. Nothing
// if the format can't hold the model.
[[nodiscard]] std::optional<std::string_view> model_name(DistortionModel model,
                                                         CameraFileFormat format);

// How a camera was calibrated: extra keys that readers of ROS and OpenCV files ignore.
struct CalibrationRecord {
  std::string calibrated_on;  // "2026-03-01"
  std::string target;         // Target::description
  int views = 0;
  double rms_px = 0.0;                 // 2-D distance
  std::optional<double> held_out_px;   // cross-validation
  double projection_mean_px = 0.0;     // 1 sigma, over the image
  double projection_largest_px = 0.0;  // 1 sigma, at the worst place
  // 1 sigma at the corners of the overlay cube (core/evaluation/evaluation.hpp), seen from
  // `table_distance_m`, with a known pose and with one found with this lens. Empty if unknown.
  std::vector<double> table_known_pose_px;
  std::vector<double> table_tracked_px;
  double table_distance_m = 0.0;
  std::vector<double> standard_deviations;  // fx fy cx cy k1 ...
  std::optional<double> focus_position;
  std::optional<double> tone_curve_sigma;
};

// Fails for a lens that the format can't hold: model_name() is empty, or Kalibr's lack of k3.
[[nodiscard]] Result<void> save_camera(const std::filesystem::path& file, const CameraModel& camera,
                                       CameraFileFormat format = CameraFileFormat::ros,
                                       const CalibrationRecord* record = nullptr);
// The text that save_camera() writes as ROS camera_info.
[[nodiscard]] std::string ros_camera_text(const CameraModel& camera);

// The same camera with n x n pixels binned, or the reverse: pixel p of the larger image lies at
// (p + 0.5) / n - 0.5 of the smaller one. Exact if both sizes show the same view. Fails unless one
// whole number scales width and height. Drops rolling_shutter_row_s, unknown at the other size.
[[nodiscard]] Result<CameraModel> scaled_to(const CameraModel& camera, int width, int height);

// Returns `focus_position`, in the units of the camera's control; nothing if the file has none.
[[nodiscard]] std::optional<double> load_focus_position(const std::filesystem::path& camera_file);

}  // namespace penumbra
