// Tracks every rigid group of tags in a frame: the table, and beside it a wall, a held prop.
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

// Returns the names of the groups other than the table, in the order of the map.
[[nodiscard]] std::vector<std::string> other_groups(const TagMap& tags);

// Returns the middle of the group's tags. The map must contain the group.
[[nodiscard]] Transform<frame::Group, frame::GroupMiddle> middle_of_group(const TagMap& tags,
                                                                          const std::string& group);

class GroupTracker {
 public:
  // `wanted`: groups to track in addition to the table; nullopt: all groups. Tracking them does not
  // change the table's poses. Fails if the map has no tag of the table.
  [[nodiscard]] static Result<GroupTracker> create(
      const CameraModel& camera, const TagMap& tags, const TrackerOptions& options = {},
      const std::optional<std::vector<std::string>>& wanted = std::nullopt);
  GroupTracker(GroupTracker&&) noexcept;
  ~GroupTracker();

  // Tracks a frame; frames must be in order of time. The same frames give the same bits. The status
  // is lost if the frame's size differs from the camera model's. See docs/tracking.md#groups.
  [[nodiscard]] TrackedFrame track(const Frame& frame);

  // Tracks with another map of the same tags, groups and table frame from the next frame on, and
  // with another row time of the same camera. That frame is aligned from the previous pose. The
  // tags of the other groups must not change. If it fails, nothing changes.
  [[nodiscard]] Result<void> set_map(const CameraModel& camera, const TagMap& tags);
  // Weighs the table's tags in the next frames for a map that has displaced each of them by this
  // standard deviation per axis [m]; 0, as after set_map(): the map is exact.
  void set_map_sigma(double sigma_m);

 private:
  struct Impl;
  explicit GroupTracker(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
