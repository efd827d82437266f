// Reads and writes camera models.
#pragma once

#include <cstddef>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"

namespace penumbra {

// The file's content determines its format; the name and the first line do not:
// - ROS camera_info YAML: image_width, image_height, camera_matrix.data, distortion_model (or
//   camera_model), distortion_coefficients.data; optional tone_curve, rolling_shutter_row_s,
//   uncertainty.overlay_px (default: the RMS of uncertainty.table_volume.tracked_px). Other keys
//   are ignored, including the flat fx: ... of some recordings. A misspelt optional key is an error
//   (YamlFields::has_optional()).
// - A ROS message as `ros2 topic echo` and `rostopic echo` print it: width, height, k, d (or K, D).
// - OpenCV FileStorage YAML, JSON and XML: camera_matrix and distortion_coefficients (also as
//   Camera_Matrix, cameraMatrix, ...), image_width, image_height or image_size; fisheye_model: 1;
//   optional tone_curve, rolling_shutter_row_s, uncertainty. Stereo: M1 and D1, M2 and D2.
// - Kalibr camchain YAML: cameras of any name; pinhole with radtan, equidistant or no distortion.
// - mrcal .cameramodel: LENSMODEL_PINHOLE, LENSMODEL_OPENCV4, 5 and 8.
// ROS and OpenCV files have 0, 4, 5, 8, 12 or 14 coefficients. Missing ones are 0; surplus ones
// must be 0. Errors name file and field.
struct LoadedCamera {
  CameraModel camera;
  // Assumptions and implausible values: one line each, with the file's name.
  std::vector<std::string> warnings;
};
// `name` selects one of several cameras in a file; it may be empty if there is only one. The error
// lists the names in the file.
[[nodiscard]] Result<LoadedCamera> load_camera_file(const std::filesystem::path& file,
                                                    const std::string& name = {});
// Returns the only camera of a file and discards the warnings.
[[nodiscard]] Result<CameraModel> load_camera(const std::filesystem::path& file);

enum class CameraFileFormat { ros, opencv, kalibr };
[[nodiscard]] std::string_view to_string(CameraFileFormat format);  // "ROS", "OpenCV", "Kalibr"
// Returns the lens model's name in this file format; for OpenCV, the value of fisheye_model.
// Returns nullopt if the format can't represent the model.
[[nodiscard]] std::optional<std::string_view> model_name(DistortionModel model,
                                                         CameraFileFormat format);

// Returns whether a file of this format can hold the lens: model_name() is known, and k3 is 0
// (Kalibr).
[[nodiscard]] bool can_hold(CameraFileFormat format, const CameraModel& camera);
// Returns the number of cameras in a file; 0 if the file is not a camera file.
[[nodiscard]] std::size_t camera_count(const std::filesystem::path& file);
// Returns the format for writing a camera to this file: that of the camera file that it replaces,
// else by its name: Kalibr's if that contains "camchain", OpenCV's for *.yml, else ROS's.
[[nodiscard]] CameraFileFormat output_format_of(const std::filesystem::path& file);

// How a camera was calibrated. Stored in extra keys, which readers of ROS and OpenCV files ignore.
// NaN: unknown; then the key is omitted.
struct CalibrationRecord {
  static constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
  std::string calibrated_on;  // "2026-03-01"
  std::string target;         // Target::description
  int views = 0;
  double rms_px = kUnknown;                 // RMS of the 2-D reprojection error
  std::optional<double> held_out_px;        // rms_px of cross-validation
  double projection_mean_px = kUnknown;     // 1 sigma, mean over the image
  double projection_largest_px = kUnknown;  // 1 sigma, maximum over the image
  // Predicted error (1 sigma) at the corners of overlay_cube(), viewed from `table_distance_m`:
  // with an exact pose, and with a pose that was estimated with this lens. Empty if unknown.
  std::vector<double> table_known_pose_px;
  std::vector<double> table_tracked_px;
  double table_distance_m = 0.0;
  std::vector<double> standard_deviations;  // fx fy cx cy k1 ...
  std::optional<double> focus_position;
  std::optional<double> tone_curve_sigma;
  std::optional<double> row_time_sigma_s;  // of rolling_shutter_row_s
};

// Fails unless can_hold().
[[nodiscard]] Result<void> save_camera(const std::filesystem::path& file, const CameraModel& camera,
                                       CameraFileFormat format = CameraFileFormat::ros,
                                       const CalibrationRecord* record = nullptr);
// Returns the ROS camera_info text that save_camera() writes.
[[nodiscard]] std::string ros_camera_text(const CameraModel& camera);

// Returns the camera for n x n binned images, or the reverse: pixel p of the larger image lies at
// (p + 0.5) / n - 0.5 of the smaller one. Exact if both images show the same view. Fails unless one
// integer n scales both sides. Clears rolling_shutter_row_s, which is unknown at the other size.
[[nodiscard]] Result<CameraModel> scaled_to(const CameraModel& camera, int width, int height);

// Returns the record in a camera file; nullopt if it has none. `camera`: that of the file. Fails if
// a value is invalid. Unknown numbers are NaN or empty.
[[nodiscard]] Result<std::optional<CalibrationRecord>> load_calibration_record(
    const std::filesystem::path& file, const CameraModel& camera);

// Returns `focus_position` [unit of the camera's focus control], or nullopt if the file has none.
[[nodiscard]] std::optional<double> load_focus_position(const std::filesystem::path& camera_file);

}  // namespace penumbra
