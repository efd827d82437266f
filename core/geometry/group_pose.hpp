// Rigid groups of tags beside the table: a wall, a held prop. Each is tracked separately.
#pragma once

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

// Its status is never better than that of the table.
struct GroupEstimate : EstimatedPose {
  std::string name;
  GroupPose T_table_group;  // meaningless when lost
  Transform<frame::Group, frame::GroupMiddle> T_group_middle;
  bool rests = false;  // on the table, as far as can be measured
};

}  // namespace penumbra
