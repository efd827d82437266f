// Tracks the camera over one rigid group of tags, from frame to frame.
#pragma once

#include <memory>
#include <optional>
#include <span>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/frame.hpp"
#include "tracking/detection/tag_detector.hpp"
#include "tracking/detection/tag_search.hpp"
#include "tracking/tracked_frame.hpp"
#include "tracking/tracker_options.hpp"

namespace penumbra {

// How a frame is measured whose search is shared with other groups (GroupTracker).
struct SharedFrame {
  // Pose from another group's tracker: tried before tags are searched for.
  std::optional<CameraPose> hint;
  bool hint_seen = false;                            // tags were found there a moment ago
  bool search = true;                                // false: this frame is not searched
  SearchResolution finest = SearchResolution::full;  // finest resolution of a search
  bool begins_finest = false;                        // the search begins at that resolution
};

class RigidTagTracker {
 public:
  // Tracks the tags of the map's group `kTableGroup`.
  [[nodiscard]] static Result<RigidTagTracker> create(const CameraModel& camera, const TagMap& tags,
                                                      const TrackerOptions& options = {});
  // Several trackers of one camera share the search of a frame.
  [[nodiscard]] static Result<RigidTagTracker> create(const CameraModel& camera, const TagMap& tags,
                                                      const TrackerOptions& options,
                                                      std::shared_ptr<TagSearch> search);
  RigidTagTracker(RigidTagTracker&&) noexcept;
  RigidTagTracker& operator=(RigidTagTracker&&) noexcept;
  ~RigidTagTracker();

  // Tracks frames in order of time. The same frames give the same poses, bit for bit. A frame whose
  // size is not the camera model's is lost, with a reason.
  [[nodiscard]] TrackedFrame track(const Frame& frame);
  // The same for a frame that the shared search has begun; the caller takes the total time.
  [[nodiscard]] TrackedFrame track(const Frame& frame, const SharedFrame& shared);

  // Estimates the pose of an earlier frame by its detected tags: tracked, uncertain, or lost with
  // the reason. The tracked state does not change, except that tags which contradict each other
  // stop guesses.
  [[nodiscard]] PoseEstimate locate(std::span<const TagDetection> detections);

 private:
  struct Impl;
  explicit RigidTagTracker(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
