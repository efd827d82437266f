// Frame -> TrackedFrame with every rigid group of tags: the table, and beside it a wall, a held
// prop. Each is a body of its own, tracked as the table is; what is searched for in a frame is
// shared.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/frame.hpp"
#include "tracking/tracked_frame.hpp"
#include "tracking/tracker_options.hpp"

namespace penumbra {

// The groups beside the table, each once, in the order of the map.
[[nodiscard]] std::vector<std::string> other_groups(const TagMap& tags);

// The middle of the group's tags. The map has to have such a group.
[[nodiscard]] Transform<frame::Group, frame::GroupMiddle> middle_of_group(const TagMap& tags,
                                                                          const std::string& group);

class GroupTracker {
 public:
  // `wanted`: the groups beside the table whose places are asked for, all of them without it;
  // others are not tracked. The table's poses are the same, bit for bit, whatever is tracked
  // beside it.
  [[nodiscard]] static Result<GroupTracker> create(
      const CameraModel& camera, const TagMap& tags, const TrackerOptions& options = {},
      const std::optional<std::vector<std::string>>& wanted = std::nullopt);
  GroupTracker(GroupTracker&&) noexcept;
  GroupTracker& operator=(GroupTracker&&) noexcept;
  ~GroupTracker();

  // As RigidTagTracker's. Times are those of all groups together.
  //
  // A group is looked for where the table's pose and its own last place on the table (at first: its
  // place in the map) put it. Where it is not, some frames are searched as a whole, beside the
  // tracking of those after them (TrackerOptions::search_timing): what is found is brought forward
  // by the camera's motion over the table, and counts once the alignment recognises it in the frame
  // that is tracked by then; else the group is held from where it was seen. Where it rests on the
  // table, its place is averaged and does not change by less than a quarter of a pixel. Not seen
  // for a moment it is held where it was, going on as it went.
  [[nodiscard]] TrackedFrame track(const Frame& frame);

 private:
  struct Impl;
  explicit GroupTracker(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
