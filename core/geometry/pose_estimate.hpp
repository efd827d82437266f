// Where the camera is, and how far that can be trusted.
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "core/geometry/transform.hpp"

namespace penumbra {

// tracked: the pose is verified and its expected overlay error (1 sigma) is under 2 px; uncertain:
// above that, or two solutions are open; held: nothing measured in this frame, the last motion is
// continued for a short while and drawn fading; lost: no pose.
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
  return "lost";
}

// How long the last motion is continued with nothing measured, and fades as it is drawn [s].
inline constexpr double kHoldSeconds = 0.5;

struct PoseEstimate {
  TrackStatus status = TrackStatus::lost;
  CameraPose T_table_camera;  // meaningless when lost
  // Covariance of the right perturbation T_table_camera * exp([nu; omega]), [m, rad], camera frame,
  // translation first.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  // Over the corners that were used, per corner (2-D distance); of an alignment, the displacement
  // of the edges that would leave its residuals.
  double reprojection_rms_px = 0.0;
  double expected_overlay_error_px =
      0.0;  // 1 sigma of the overlay error (see core/evaluation/evaluation.hpp), from the
            // covariance and what is known of the lens
  // Reprojection RMS of the second pose that explains a planar target over that of the best one;
  // infinite when there is only one. Near 1 the view is ambiguous.
  double ambiguity_ratio = 0.0;
  int tags_used = 0;
  // Ids of tags in view that contradict the others, as a tag that was moved does: none of them
  // counts.
  std::vector<int> tags_left_out;
  double age_s = 0.0;  // since the last measured pose; 0 unless held
  // Of the last measured pose, where held: tracked or uncertain. Fading starts from how that one
  // was drawn.
  TrackStatus held_from = TrackStatus::tracked;
  std::string reason;  // why the pose is uncertain, held or lost, in a few words for the HUD; empty
                       // when tracked

  [[nodiscard]] bool has_pose() const { return status != TrackStatus::lost; }
};

}  // namespace penumbra
