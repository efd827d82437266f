// Camera poses over time, as TUM files: `timestamp tx ty tz qx qy qz qw`, T_table_camera, seconds
// and metres; '#' starts a comment. EuRoC's ground truth is read as well.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

struct StampedPose {
  std::int64_t timestamp_ns = 0;
  CameraPose T_table_camera;
  std::string comment;  // written after the pose as "# comment"; read back when there is one
};

// Poses in order of time; timestamps increase.
struct Trajectory {
  std::vector<StampedPose> poses;
  bool of_body =
      false;  // poses of the body (IMU) and not of the camera, as in EuRoC's ground truth

  // The pose whose timestamp is nearest to `timestamp_ns`, or null when none is within
  // `tolerance_ns`.
  [[nodiscard]] const StampedPose* at(std::int64_t timestamp_ns,
                                      std::int64_t tolerance_ns = 1'000'000) const;
};

// Interpolates a trajectory that is not empty. The velocity at a pose is that between its two
// neighbours (Catmull-Rom, for uneven times). Positions are cubics, rotations cubics of the
// rotation vector from the pose before. Beyond the ends, the end's velocity extrapolates.
[[nodiscard]] CameraPose interpolate_pose(const Trajectory& trajectory, std::int64_t timestamp_ns);

// Reads a TUM file, or a CSV file as EuRoC's ground truth (data.csv): time in whole nanoseconds,
// position, quaternion (w x y z, or as the header names it), further columns that are ignored.
// Errors name file and line: wrong count of numbers, a non-finite number, a quaternion that is not
// of length 1, a time too large for seconds or not after the one before.
[[nodiscard]] Result<Trajectory> load_trajectory(const std::filesystem::path& file);
[[nodiscard]] Result<void> save_trajectory(const std::filesystem::path& file,
                                           const Trajectory& trajectory);
// One line, without the line break: timestamps with 9 decimals, numbers with 17 significant digits.
[[nodiscard]] std::string format_tum(const StampedPose& pose);

}  // namespace penumbra
