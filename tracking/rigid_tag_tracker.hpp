// Tracks the camera over one rigid group of tags, from frame to frame. Poses are relative to
// the tag map's frame: the table, or the middle of another group (GroupTracker makes its map).
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string_view>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/frame.hpp"
#include "tracking/detection/tag_search.hpp"
#include "tracking/motion/pose_history.hpp"
#include "tracking/tracked_frame.hpp"
#include "tracking/tracker_options.hpp"

namespace penumbra {

struct TrackRequest {
  // Pose from another group's tracker: tried before tags are searched for.
  std::optional<MapFromCamera> hint;
  bool hint_seen = false;                            // a recent search found tags at the hint
  bool search = true;                                // false: this frame is not searched
  SearchResolution finest = SearchResolution::full;  // finest resolution of a search
  bool begins_finest = false;                        // begin the search at that resolution
};

struct TrackedTags {
  MapPoseEstimate pose;
  TrackTimes times;
};

class RigidTagTracker {
 public:
  // Tracks the tags of one group of the map, which must have a tag. Trackers of one camera share
  // the search of a frame.
  [[nodiscard]] static Result<RigidTagTracker> create(const CameraModel& camera, const TagMap& tags,
                                                      std::string_view group,
                                                      const TrackerOptions& options,
                                                      std::shared_ptr<TagSearch> search);
  RigidTagTracker(RigidTagTracker&&) noexcept;
  RigidTagTracker& operator=(RigidTagTracker&&) noexcept;
  ~RigidTagTracker();

  // Tracks a frame that the shared search has begun. The caller adds the total time.
  [[nodiscard]] TrackedTags track(const Frame& frame, const TrackRequest& request);

  // Sets AlignmentInput::map_sigma_m for the next frames; 0 at first.
  void set_map_sigma(double sigma_m);

  // Estimates the pose of an earlier frame from its detected tags: tracked, uncertain, or lost with
  // a reason. Changes no tracked state, but inconsistent tags disable hints until the next search.
  [[nodiscard]] MapPoseEstimate locate(std::span<const TagDetection> detections);

 private:
  struct Impl;
  explicit RigidTagTracker(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
