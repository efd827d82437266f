// Tracks every rigid group of tags in a frame: the table, and beside it a wall, a held prop. Each
// group has one tracker; they share the search for tags in a frame.
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

// The middle of the group's tags. The map must have such a group.
[[nodiscard]] Transform<frame::Group, frame::GroupMiddle> middle_of_group(const TagMap& tags,
                                                                          const std::string& group);

class GroupTracker {
 public:
  // `wanted`: the groups beside the table that are tracked; without it, all of them. The table's
  // poses are the same, bit for bit, whatever is tracked beside it.
  [[nodiscard]] static Result<GroupTracker> create(
      const CameraModel& camera, const TagMap& tags, const TrackerOptions& options = {},
      const std::optional<std::vector<std::string>>& wanted = std::nullopt);
  GroupTracker(GroupTracker&&) noexcept;
  GroupTracker& operator=(GroupTracker&&) noexcept;
  ~GroupTracker();

  // As RigidTagTracker's. Times are those of all groups together.
  //
  // A group is looked for where the table's pose and its last place on the table (at first: its
  // place in the map) put it. Where it is missing, some frames are searched as a whole while the
  // frames after them are tracked (TrackerOptions::search_timing). What is found is moved by the
  // camera's motion since, and counts once the alignment verifies it; else the group is
  // extrapolated from where it was seen. The place of a group that rests on the table is averaged,
  // and changes in steps of a quarter of a pixel. A group that is not seen for a moment is
  // extrapolated with its motion.
  [[nodiscard]] TrackedFrame track(const Frame& frame);

 private:
  struct Impl;
  explicit GroupTracker(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
