// Rigid groups of tags beside the table: a wall, a held prop. Each is tracked as a body of its own.
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "core/geometry/pose_estimate.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

// The group that the table frame is fixed to.
inline constexpr std::string_view kTableGroup = "table";

namespace frame {
// The table frame of the tag map, carried along by the group's tags: it is the table frame itself
// as long as the group stands where the map has it.
struct Group;
// Origin at the middle of the group's tags, axes of its first tag.
struct GroupMiddle;
}  // namespace frame

using GroupPose = Transform<frame::Table, frame::Group>;  // T_table_group

struct GroupEstimate {
  std::string name;
  // As PoseEstimate's, of the group on the table: never better than the table's own.
  TrackStatus status = TrackStatus::lost;
  GroupPose T_table_group;  // meaningless when lost
  Transform<frame::Group, frame::GroupMiddle> T_group_middle;
  // Of the camera over the group's middle as it is drawn: T_middle_camera * exp([nu; omega])
  // [m, rad], camera frame.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  // 1 sigma of the overlay error of a cube that stands on the group's middle.
  double expected_overlay_error_px = 0.0;
  double reprojection_rms_px = 0.0;              // as PoseEstimate's, of the group's own tags
  int tags_used = 0;                             // 0: not measured in this frame
  std::vector<int> tags_left_out;                // as PoseEstimate's, of the group's own tags
  bool rests = false;                            // on the table, as far as can be measured
  double age_s = 0.0;                            // since the last measured pose; 0 unless held
  TrackStatus held_from = TrackStatus::tracked;  // as PoseEstimate's
  std::string reason;                            // empty when tracked

  [[nodiscard]] bool has_pose() const { return status != TrackStatus::lost; }
};

}  // namespace penumbra
