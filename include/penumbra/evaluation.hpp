// Errors of estimated camera poses against true ones, in the table frame and without alignment, as
// `penumbra evaluate` computes them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <penumbra/api.hpp>
#include <penumbra/camera.hpp>
#include <penumbra/types.hpp>
#include <string>
#include <vector>

namespace penumbra::evaluation {

using types::CameraModel;
using types::Pose;

struct StampedPose {
  std::int64_t timestamp_ns = 0;
  Pose T_table_camera = {};
  std::optional<double> predicted_px = {};  // predicted overlay error; not in TUM files
};
using Trajectory = std::vector<StampedPose>;  // times increase

// Reads a TUM file (timestamp tx ty tz qx qy qz qw), ground truth of EuRoC, or the tracked poses of
// a frame log (--frame-log FILE.csv) with their predicted errors.
[[nodiscard]] PENUMBRA_API Trajectory load_trajectory(const std::filesystem::path& file);
// Writes a TUM file, as `penumbra replay --poses` does.
PENUMBRA_API void save_trajectory(const std::filesystem::path& file, const Trajectory& trajectory);

struct Options {
  // The truth is interpolated across gaps up to this [s].
  double max_gap_s = 0.1;
  double time_offset_s = 0.0;  // added to the times of the estimate [s]
};

// In the unit of the values; zeros if there are none.
struct Statistics {
  double rmse = 0.0;
  double median = 0.0;
  double p95 = 0.0;
  double max = 0.0;
};

struct Errors {
  int frames_with_truth = 0;  // true poses
  int frames_estimated = 0;   // estimated poses
  int frames_judged = 0;      // estimated poses that have a true pose
  int outside_truth = 0;      // not judged: before the first or after the last true pose
  int gap_too_long = 0;       // not judged: in a gap longer than Options::max_gap_s
  Statistics translation_mm;
  Statistics rotation_deg;
  // Distance between the pixels to which the two poses project the corners of a cube of 0.2 m that
  // stands on the table's origin [px].
  Statistics overlay_px;
  // RMS change of this difference from frame to frame [px]; nullopt if no two frames follow each
  // other.
  std::optional<double> jitter_px;
  std::vector<std::string> warnings;  // such as a likely mistake in the convention of the truth
};

// Throws if a trajectory is empty, a pose is not finite or not a unit quaternion, times don't
// increase, or no pose can be compared. Thread-safe.
[[nodiscard]] PENUMBRA_API Errors evaluate(const CameraModel& camera, const Trajectory& estimated,
                                           const Trajectory& truth, const Options& options = {});

}  // namespace penumbra::evaluation
