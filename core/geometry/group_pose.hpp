// Rigid groups of tags beside the table: a wall, a held prop. Each group is tracked separately.
#pragma once

#include <string>
#include <string_view>

#include "core/geometry/pose_estimate.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

// Name of the group that defines the table frame.
inline constexpr std::string_view kTableGroup = "table";

namespace frame {
// The tag map's table frame, attached to the group's tags. It equals the table frame as long as the
// group has the pose given in the map.
struct Group;
// Origin at the centroid of the group's tags, axes of its first tag.
struct GroupMiddle;
}  // namespace frame

using GroupPose = Transform<frame::Table, frame::Group>;  // T_table_group

// EstimatedPose::status is never better than the status of the table's pose.
struct GroupEstimate : EstimatedPose {
  std::string name;
  GroupPose T_table_group;  // meaningless when lost
  Transform<frame::Group, frame::GroupMiddle> T_group_middle;
  bool rests = false;  // at rest on the table, within the measurement noise
};

}  // namespace penumbra
