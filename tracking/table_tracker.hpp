// Frame -> TrackedFrame: where the camera is above the table. Holds the only state between frames.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/frame.hpp"
#include "tracking/detection/tag_detector.hpp"
#include "tracking/detection/tag_search.hpp"

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

// When a frame is searched for tags that are not where they were (GroupTracker).
enum class SearchTiming {
  in_frame,  // before the frame is done: it waits for the search
  // Groups beside a table that is tracked: what is found is used in the frame after it, the same on
  // every machine. The table: in the frame.
  next_frame,
  // What is found is used in the frame that finds the search done. The table is searched for in the
  // frame too, but at the full resolution only where a search beside it has just seen its tags.
  when_done,
};

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
  SearchTiming search_timing = SearchTiming::next_frame;
  // next_frame: searched by a thread of its own, beside whatever follows; the same poses without.
  // when_done always has one.
  bool search_thread = false;
  double hold_s = kHoldSeconds;  // how long the last motion is continued with nothing measured
};

// Of the last frame. A wall time of 0: that stage did not run.
struct TrackTimes {
  double total_ms = 0.0, detect_ms = 0.0, align_ms = 0.0, solve_ms = 0.0;  // wall
  double total_cpu_ms = 0.0, detect_cpu_ms = 0.0, align_cpu_ms = 0.0,
         solve_cpu_ms = 0.0;  // CPU time: of the calling thread, and of a search beside it
  // Of a search beside the tracking whose tags were used in this frame: times of the thread that
  // did it. Its CPU time is in the total, its wall time only where that thread is this one.
  double search_ms = 0.0, search_cpu_ms = 0.0;
  bool search_came = false;     // whether tags of such a search were used
  bool full_detection = false;  // whether a full-frame detection ran
  bool coarse_search = false;   // whether the pattern was found further off, in a smaller picture
  bool box_detection = false;   // whether one of a part of the frame did, and was enough
  bool every_pixel = false;     // whether the last alignment could use every pixel at an edge
  int samples = 0;              // pixels that the last alignment used
  // Of it: tags of the map that were not looked at, and whether it took fewer pixels than it might
  // because the pose was good enough.
  int tags_out_of_view = 0, tags_too_small = 0;
  bool sampling_stopped = false;
  bool fewer_pixels = false;  // it was kept to a limited number of pixels for the view moves
  bool near_start = false;    // it began near, so without its wide stage
  bool corner_solve_skipped = false;  // tags were found, their pose not solved for by Ceres
};

struct TrackedFrame {
  Frame frame;
  PoseEstimate pose;
  TrackTimes times;
  std::vector<GroupEstimate> groups;  // beside the table, in the order of the tag map
  int groups_skipped = 0;             // not tracked, because nothing asks where they are
};

// PoseEstimate's reason where two poses explain the tags equally well.
inline constexpr std::string_view kTwoPoses = "two poses fit";
// Reasons for which tags of the map were read but agree with no pose: the camera file or the map is
// wrong. The second is followed by the residual in parentheses.
inline constexpr std::string_view kContradicting = "the tags contradict each other";
inline constexpr std::string_view kNotFitting = "the tags do not fit the map";

// How a frame is measured whose search is shared with others (GroupTracker).
struct SharedFrame {
  // Where the camera may be, from elsewhere: tried before tags are searched for.
  std::optional<CameraPose> hint;
  bool hint_seen = false;                            // tags were found there a moment ago
  bool search = true;                                // false: nothing is searched for in this frame
  SearchResolution finest = SearchResolution::full;  // how finely it may be
  bool begins_finest = false;                        // nor any coarser
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
  // The same for a frame that the shared search has begun; the total time is its owner's to take.
  [[nodiscard]] TrackedFrame track(const Frame& frame, const SharedFrame& shared);

  // What these tags of an earlier frame say about the pose in that frame: tracked, uncertain, or
  // lost with the reason. Of what is followed nothing changes, but after tags that contradict each
  // other no guess is.
  [[nodiscard]] PoseEstimate locate(std::span<const TagDetection> detections);

 private:
  struct Impl;
  explicit TableTracker(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
