// The estimated camera pose and its uncertainty.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/geometry/tracking_reasons.hpp"
#include "core/geometry/transform.hpp"
#include "core/text/enum_names.hpp"

namespace penumbra {

// - tracked: the pose is verified and its predicted overlay error (1 sigma) is below 2 px.
// - uncertain: the predicted error is larger, or two poses are possible.
// - held: no measurement in this frame; extrapolated for up to kHoldSeconds and faded out.
// - lost: no pose.
enum class TrackStatus { tracked, uncertain, held, lost };

[[nodiscard]] constexpr std::string_view to_string(TrackStatus status) {
  constexpr auto kNames =
      std::to_array<EnumName<TrackStatus>>({{TrackStatus::tracked, "tracked"},
                                            {TrackStatus::uncertain, "uncertain"},
                                            {TrackStatus::held, "held"},
                                            {TrackStatus::lost, "lost"}});
  return name_of(kNames, status);
}

inline constexpr double kHoldSeconds = 0.5;  // [s]

struct MeasuredTags {
  // RMS reprojection error (2-D) of the used corners. After an image alignment: the displacement of
  // the tags' edges that would cause the photometric residuals.
  double reprojection_rms_px = 0.0;
  int tags_used = 0;  // 0: not measured in this frame
  std::vector<RejectedTag> tags_rejected;
};

// Status and uncertainty of the camera's pose relative to the table or to a group of tags.
struct EstimatedPose : MeasuredTags {
  TrackStatus status = TrackStatus::lost;
  // Covariance of the right perturbation T_table_camera * exp([nu; omega]), [m, rad], camera frame,
  // translation first. For a group: of T_middle_camera.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  // Overlay error (1 sigma, core/evaluation/evaluation.hpp) from the covariance and the lens
  // uncertainty. For a group: of a cube that stands on the origin of frame::GroupMiddle.
  double predicted_overlay_error_px = 0.0;
  double age_s = 0.0;  // since the last measured pose; 0 unless held
  // If held: status of the latest measured pose, tracked or uncertain; it sets the initial opacity.
  TrackStatus held_from = TrackStatus::tracked;
  PoseReason reason;

  [[nodiscard]] bool has_pose() const { return status != TrackStatus::lost; }
};

struct PoseEstimate : EstimatedPose {
  CameraPose T_table_camera;  // meaningless when lost
  // Reprojection RMS of a planar target's second pose divided by that of the best pose. Near 1 the
  // view is ambiguous; infinite if there is only one pose.
  double ambiguity_ratio = 0.0;
};

}  // namespace penumbra
