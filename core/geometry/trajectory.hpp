// Camera poses over time. Reads and writes TUM files: `timestamp tx ty tz qx qy qz qw`,
// T_table_camera, in seconds and metres; '#' starts a comment. Also reads EuRoC's ground truth and
// frame logs.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

struct StampedPose {
  std::int64_t timestamp_ns = 0;
  CameraPose T_table_camera;
  std::string comment;  // written after the pose as "# comment"; read back when there is one
  std::optional<double> predicted_px = {};  // predicted overlay error; not written to TUM files
};

// Poses in order of time; timestamps increase.
struct Trajectory {
  std::vector<StampedPose> poses;
  // True: poses of the body (IMU) instead of the camera, as in EuRoC's ground truth.
  bool of_body = false;
  int untracked = 0;  // frames of a frame log without a tracked pose, which `poses` lacks

  // Returns the pose with the timestamp nearest to `timestamp_ns`, or null if none is within
  // `tolerance_ns`.
  [[nodiscard]] const StampedPose* at(std::int64_t timestamp_ns,
                                      std::int64_t tolerance_ns = 1'000'000) const;
};

// Interpolates with a non-uniform Catmull-Rom spline: position, and rotation vector relative to the
// previous pose. Extrapolates at constant velocity beyond the ends. `trajectory` must not be empty.
[[nodiscard]] CameraPose interpolate_pose(const Trajectory& trajectory, std::int64_t timestamp_ns);

// Reads a TUM file, or a CSV file in the format of EuRoC's ground truth: time in whole nanoseconds,
// position, quaternion (w x y z, unless the header says otherwise); further columns are ignored. Of
// a frame log (CSV), reads the tracked poses of the camera, with predicted_px.
// Fails, with file and line, on a wrong count of numbers, a non-finite number, a quaternion that is
// not of unit length, timestamps that do not increase, and times that can't be in seconds.
[[nodiscard]] Result<Trajectory> load_trajectory(const std::filesystem::path& file);
[[nodiscard]] Result<void> save_trajectory(const std::filesystem::path& file,
                                           const Trajectory& trajectory);
// Returns a line without line break: 9 decimals of the timestamp, 17 significant digits otherwise.
[[nodiscard]] std::string format_tum(const StampedPose& pose);

}  // namespace penumbra
