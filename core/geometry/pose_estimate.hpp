// The estimated camera pose and its uncertainty.
#pragma once

#include <Eigen/Core>
#include <string_view>
#include <vector>

#include "core/geometry/tracking_reasons.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

// tracked: the pose is verified and its predicted overlay error (1 sigma) is under 2 px; uncertain:
// the error is larger, or two poses are possible; held: nothing was measured in this frame, the
// pose is extrapolated for at most kHoldSeconds and drawn fading; lost: no pose.
enum class TrackStatus { tracked, uncertain, held, lost };

[[nodiscard]] constexpr std::string_view to_string(TrackStatus status) {
  switch (status) {
    case TrackStatus::tracked:
      return "tracked";
    case TrackStatus::uncertain:
      return "uncertain";
    case TrackStatus::held:
      return "held";
    case TrackStatus::lost:
      return "lost";
  }
  return {};
}

inline constexpr double kHoldSeconds = 0.5;  // [s]

struct MeasuredTags {
  // RMS 2-D distance of the used corners; after an alignment, the edge displacement [px] that
  // explains its residuals.
  double reprojection_rms_px = 0.0;
  int tags_used = 0;  // 0: not measured in this frame
  std::vector<RejectedTag> tags_rejected;
};

// Status and uncertainty of the camera's pose over the table or over a group of tags.
struct EstimatedPose : MeasuredTags {
  TrackStatus status = TrackStatus::lost;
  // Covariance of the right perturbation T_table_camera * exp([nu; omega]), [m, rad], camera frame,
  // translation first. Of a group: of T_middle_camera, as it is drawn.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  // 1 sigma [px] of the overlay (core/evaluation/evaluation.hpp), from the covariance and the lens
  // uncertainty. Of a group: of a cube that stands on the group's middle.
  double predicted_overlay_error_px = 0.0;
  double age_s = 0.0;  // since the last measured pose; 0 unless held
  // Status of the last measured pose, where held: tracked or uncertain. Fading starts from it.
  TrackStatus held_from = TrackStatus::tracked;
  PoseReason reason;

  [[nodiscard]] bool has_pose() const { return status != TrackStatus::lost; }
};

struct PoseEstimate : EstimatedPose {
  CameraPose T_table_camera;  // meaningless when lost
  // Reprojection RMS of the second pose of a planar target over that of the best one; infinite if
  // there is one only. Near 1 the view is ambiguous.
  double ambiguity_ratio = 0.0;
};

}  // namespace penumbra
