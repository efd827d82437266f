// Frame -> TrackedFrame: where the camera is above the table. Holds the only state between frames.
#pragma once

#include <memory>
#include <optional>
#include <string_view>
#include <vector>

#include "core/camera_model.hpp"
#include "core/error.hpp"
#include "core/frame.hpp"
#include "core/group_pose.hpp"
#include "core/pose_estimate.hpp"
#include "core/tag_map.hpp"
#include "tracking/tag_detector.hpp"
#include "tracking/tag_search.hpp"

namespace penumbra {

// How a frame is measured once a pose is held.
enum class TrackingMode {
  detect,     // every frame by detection: the baseline
  fast,       // the tag pattern aligned with the image, a limited number of pixels
  accurate,   // every pixel at an edge, except where the picture is blurred by motion
  automatic,  // fast while the view moves, accurate when it rests or shows less than three tags
};

[[nodiscard]] std::string_view to_string(TrackingMode mode);
// "auto" for automatic; nothing for a word that is none of them.
[[nodiscard]] std::optional<TrackingMode> tracking_mode_from_string(std::string_view name);

struct TrackerOptions {
  TrackingMode mode = TrackingMode::automatic;
  TagDetectorOptions detector;
  double tracked_overlay_px = 2.0;  // expected overlay error up to which a pose counts as tracked
  double ambiguity_ratio = 1.6;  // a second pose whose reprojection RMS is less than this times the
                                 // best one's leaves the view open
  double max_reprojection_rms_px = 3.0;  // a worse fit is no pose
  // Pixels are sampled until the expected overlay error of their noise is below this [px]; 0: as
  // many as the mode says. `fast` never takes more than its own number.
  double pose_budget_px = 0.0;
  double hold_s = kHoldSeconds;  // how long the last motion is continued with nothing measured
};

// Of the last frame. A wall time of 0: that stage did not run.
struct TrackTimes {
  double total_ms = 0.0, detect_ms = 0.0, align_ms = 0.0, solve_ms = 0.0;  // wall
  double total_cpu_ms = 0.0, detect_cpu_ms = 0.0, align_cpu_ms = 0.0,
         solve_cpu_ms = 0.0;    // CPU time of the calling thread
  bool full_detection = false;  // whether a full-frame detection ran
  bool every_pixel = false;     // whether the last alignment could use every pixel at an edge
  int samples = 0;              // pixels that the last alignment used
};

struct TrackedFrame {
  Frame frame;
  PoseEstimate pose;
  TrackTimes times;
  std::vector<GroupEstimate> groups;  // beside the table, in the order of the tag map
  int groups_skipped = 0;             // not tracked, because nothing asks where they are
};

// How a frame is measured whose search is shared with others (GroupTracker).
struct SharedFrame {
  // Where the camera may be, from elsewhere: tried before tags are searched for.
  std::optional<CameraPose> hint;
  bool search = true;  // false: nothing is searched for in this frame
};

class TableTracker {
 public:
  [[nodiscard]] static Result<TableTracker> create(const CameraModel& camera, const TagMap& tags,
                                                   const TrackerOptions& options = {});
  // Several trackers of one camera share what is searched for in a frame.
  [[nodiscard]] static Result<TableTracker> create(const CameraModel& camera, const TagMap& tags,
                                                   const TrackerOptions& options,
                                                   std::shared_ptr<TagSearch> search);
  TableTracker(TableTracker&&) noexcept;
  TableTracker& operator=(TableTracker&&) noexcept;
  ~TableTracker();

  // Frames in order of time. Deterministic: the same frames give the same poses, bit for bit. A
  // frame whose size is not the camera model's is lost, with the reason said.
  [[nodiscard]] TrackedFrame track(const Frame& frame);
  // The same for a frame that the shared search has begun.
  [[nodiscard]] TrackedFrame track(const Frame& frame, const SharedFrame& shared);

 private:
  struct Impl;
  explicit TableTracker(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
