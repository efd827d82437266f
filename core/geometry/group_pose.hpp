// Rigid groups of tags beside the table: a wall, a held prop. Each is tracked separately.
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>

#include "core/geometry/pose_estimate.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

// The group that the table frame is fixed to.
inline constexpr std::string_view kTableGroup = "table";

namespace frame {
// The tag map's table frame, attached to the group's tags: it equals the table frame while the
// group stands where the map has it.
struct Group;
// Origin at the centroid of the group's tags, axes of its first tag.
struct GroupMiddle;
}  // namespace frame

using GroupPose = Transform<frame::Table, frame::Group>;  // T_table_group

struct GroupEstimate : MeasuredTags {
  std::string name;
  // Status of the group's pose on the table: never better than that of the table.
  TrackStatus status = TrackStatus::lost;
  GroupPose T_table_group;  // meaningless when lost
  Transform<frame::Group, frame::GroupMiddle> T_group_middle;
  // Covariance of T_middle_camera * exp([nu; omega]) as it is drawn, [m, rad], camera frame.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  // 1 sigma of the overlay error of a cube that stands on the group's middle.
  double predicted_overlay_error_px = 0.0;
  bool rests = false;  // on the table, as far as can be measured
  // As in PoseEstimate.
  double age_s = 0.0;
  TrackStatus held_from = TrackStatus::tracked;
  PoseReason reason;

  [[nodiscard]] bool has_pose() const { return status != TrackStatus::lost; }
};

}  // namespace penumbra
