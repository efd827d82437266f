// How far an estimated camera path is from the truth, in the table frame, with no alignment (the
// table frame is known).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/evaluation/pairing.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/trajectory.hpp"

namespace penumbra {

// The 8 corners of a 0.2 m cube standing on the table's origin (x, y = +-0.1, z = 0 and 0.2), table
// frame [m].
[[nodiscard]] std::array<Eigen::Vector3d, 8> overlay_cube();

// In the unit of the values.
struct Statistics {
  double rmse = 0.0;
  double median = 0.0;
  double p95 = 0.0;
  double max = 0.0;
};
// All zero for no values. median and p95 interpolate linearly between order statistics.
[[nodiscard]] Statistics statistics_of(std::vector<double> values);

// Where the corners of the overlay cube appear under both poses: estimated - true [px]. Corners
// behind the true camera are left out (valid[i] false); one that is behind the estimated camera
// alone counts as the angle between its two directions times the focal length. Beyond the lens
// model's valid radius the model is continued linearly.
struct OverlayDifference {
  std::array<Eigen::Vector2d, 8> difference_px{};
  std::array<bool, 8> valid{};
  [[nodiscard]] double rms_px() const;
};
[[nodiscard]] OverlayDifference overlay_difference(const CameraModel& camera,
                                                   const CameraPose& estimated,
                                                   const CameraPose& truth);

struct Evaluation {
  int frames_with_truth = 0;  // true poses; in a run: processed frames with truth
  int frames_estimated = 0;   // estimated poses
  int frames_with_pose = 0;   // of frames_with_truth: those with a judged pose nearest to them
  int frames_judged = 0;      // of frames_estimated, those with a true pose at their time
  std::array<int, 2> frames_not_judged{};  // the others, by NotJudged
  std::int64_t time_offset_ns = 0;         // PairingOptions::time_offset_ns that was added
  Statistics translation_mm;               // |t_estimated - t_true|
  Statistics rotation_deg;                 // angle of R_estimated^T R_true
  Statistics overlay_px;                   // over all corners of all judged frames
  Statistics overlay_frame_px;             // over the frames' RMS over the corners
  // RMS of the change of (estimated - true) corner positions between consecutive judged frames:
  // neighbours in the estimate that are at most 1.5 frame intervals apart.
  double jitter_px = 0.0;
  int jitter_changes = 0;  // number of these changes; 0: the jitter is unknown
};
// Compares each estimated pose with the true one at its time (core/evaluation/pairing.hpp).
// `frame_interval_ns`: time between two frames; 0: the median between two estimated poses.
[[nodiscard]] Evaluation evaluate(const CameraModel& camera, const Trajectory& estimated,
                                  const Trajectory& truth, const PairingOptions& options = {},
                                  std::int64_t frame_interval_ns = 0);

// The camera over the middle of a group of tags (T_middle_camera) at the camera's times at which
// the group's place on the table (T_table_group) is known, as pose_at() finds it: what a group's
// overlay error is of. `max_gap_ns` 0: only places at the same times.
[[nodiscard]] Trajectory over_group(
    const Trajectory& camera, const Trajectory& group,
    const Transform<frame::Group, frame::GroupMiddle>& T_group_middle, std::int64_t max_gap_ns = 0);

// 1 sigma of the overlay error (RMS over the cube's corners) for a pose covariance as in
// PoseEstimate.
[[nodiscard]] double expected_overlay_error_px(const CameraModel& camera, const CameraPose& pose,
                                               const Eigen::Matrix<double, 6, 6>& covariance);
// The same with what the lens itself adds, as far as the camera file says (overlay_sigma_px).
[[nodiscard]] double with_lens_error_px(const CameraModel& camera, double expected_px);

}  // namespace penumbra
