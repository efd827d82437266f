// Errors of an estimated trajectory against the truth, in the table frame and without alignment.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/evaluation/pairing.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/statistics.hpp"

namespace penumbra {

// Returns the 8 corners of a 0.2 m cube that stands on the table's origin (x, y = +-0.1, z = 0 and
// 0.2), in the table frame [m].
[[nodiscard]] std::array<Eigen::Vector3d, 8> overlay_cube();

// Returns zeros for no values. median and p95 interpolate linearly between order statistics.
[[nodiscard]] Statistics statistics_of(std::vector<double> values);

// Pixels of the overlay cube's corners: estimated - true [px]. Corners behind the true camera are
// not valid. A corner behind only the estimated camera gets the angle between its two directions
// times the focal length. Projection: CameraModel::project_extended(). `Origin`: Table or Map.
struct OverlayDifference {
  std::array<Eigen::Vector2d, 8> difference_px{};
  std::array<bool, 8> valid{};
  [[nodiscard]] double rms_px() const;
};
template <class Origin>
[[nodiscard]] OverlayDifference overlay_difference(
    const CameraModel& camera, const Transform<Origin, frame::Camera>& estimated,
    const Transform<Origin, frame::Camera>& truth);

// Errors of one estimated pose.
struct PoseErrors {
  std::int64_t timestamp_ns = 0;  // of the estimate, without PairingOptions::time_offset_ns
  std::optional<NotEvaluated> not_judged;  // then there are no errors
  double translation_mm = 0.0, rotation_deg = 0.0;
  std::optional<double> overlay_px;  // RMS over the corners; nullopt if none is valid
  // RMS change of the corners since the previous pose; nullopt if that is not judged or too old.
  std::optional<double> jitter_px;
  std::optional<double> predicted_px;  // StampedPose::predicted_px
  std::optional<double> ratio;         // overlay_px / predicted_px
};

struct Evaluation {
  std::vector<PoseErrors> poses;  // all estimated poses, in order of time
  int frames_with_truth = 0;      // all true poses; during a run, only those of processed frames
  int frames_estimated = 0;       // estimated poses
  int frames_with_pose = 0;       // number of frames_with_truth that have an evaluated estimate
  int frames_judged = 0;          // number of frames_estimated that were evaluated
  std::array<int, 2> frames_not_judged{};  // by NotEvaluated: estimates without evaluation
  std::int64_t time_offset_ns = 0;         // PairingOptions::time_offset_ns that was added
  Statistics translation_mm;               // |t_estimated - t_true|
  Statistics rotation_deg;                 // angle of R_estimated^T R_true
  Statistics overlay_px;                   // over all corners of all evaluated frames
  Statistics overlay_frame_px;             // over the RMS of each frame
  // RMS change of (estimated - true) corner positions between consecutive evaluated poses with a
  // gap of up to 1.5 frame intervals.
  double jitter_px = 0.0;
  int jitter_changes = 0;  // number of pose pairs; 0: the jitter is unknown
  // Overlay error over predicted error of each evaluated frame that has both.
  int frames_with_ratio = 0;
  Statistics frame_ratio;
  double share_above_3 = 0.0;  // fraction of these frames with a ratio above 3
};
// Compares each estimated pose with the true one at its time (core/evaluation/pairing.hpp).
// `frame_interval_ns`: time between two frames; 0: the median between two estimated poses.
[[nodiscard]] Evaluation evaluate(const CameraModel& camera, const Trajectory& estimated,
                                  const Trajectory& truth, const PairingOptions& options = {},
                                  std::int64_t frame_interval_ns = 0);

// Returns T_middle_camera of a group of tags at those times of `camera` at which pose_at() finds
// the group's pose (T_table_group). `max_gap_ns` 0: only at times that both trajectories have.
[[nodiscard]] Trajectory relative_to_group(
    const Trajectory& camera, const Trajectory& group,
    const Transform<frame::Group, frame::GroupMiddle>& T_group_middle, std::int64_t max_gap_ns = 0);

// Returns the predicted overlay error (1 sigma, RMS over the corners) for a pose's covariance.
template <class Origin>
[[nodiscard]] double predicted_overlay_error_px(const CameraModel& camera,
                                                const Transform<Origin, frame::Camera>& pose,
                                                const Eigen::Matrix<double, 6, 6>& covariance);
// Adds the lens uncertainty of the camera file (overlay_sigma_px).
[[nodiscard]] double add_lens_uncertainty_px(const CameraModel& camera, double predicted_px);

}  // namespace penumbra
