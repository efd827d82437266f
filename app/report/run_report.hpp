// Measurements of a run. They are collected for each frame and reported as JSON or as a text table.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/run_inputs.hpp"
#include "app/session/map_refinement.hpp"
#include "app/session/pose_smoother.hpp"
#include "app/session/session.hpp"
#include "core/error.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/evaluation/running_statistics.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/tracking_reasons.hpp"
#include "core/stopwatch.hpp"
#include "render/render_work.hpp"
#include "render/scene/shadow_events.hpp"
#include "tracking/detection/image_check.hpp"
#include "tracking/evaluation/residual_causes.hpp"

namespace penumbra {

struct StageSummary {
  double median = 0.0, p95 = 0.0, max = 0.0, mean = 0.0;  // wall time [ms]
  double cpu_median = 0.0, cpu_mean = 0.0;                // CPU time of the working thread [ms]
  std::size_t count = 0;
};

class StageTimes {
 public:
  void add(StageTime time);
  [[nodiscard]] StageSummary summary() const;
  // Returns the mean wall time of the last kRecentFrames frames [ms]; nullopt before the first
  // frame.
  [[nodiscard]] std::optional<double> recent_ms() const;

 private:
  static constexpr std::size_t kRecentFrames = 30;
  RunningStatistics wall_ms_, cpu_ms_;
  std::array<double, kRecentFrames> recent_ms_{};  // ring buffer
};

// Counts frames by the status of their pose. Also summarises the tags measured in these frames.
struct TrackingCounts {
  int frames_tracked = 0, frames_uncertain = 0, frames_held = 0, frames_lost = 0;
  Statistics reprojection_rms_px;  // over the frames with measured tags
  bool tags_measured = false;      // true if tags were measured in any frame
  // For each TagRejection: number of frames in which a tag was rejected, by tag id.
  std::array<std::map<std::string, std::int64_t>, kTagRejections> tags_rejected;
  void add(TrackStatus status, const MeasuredTags& tags);
};

struct GroupReport : TrackingCounts {
  std::string name;
  // Errors of the camera's pose relative to the group's middle, in the tracked frames.
  std::optional<Evaluation> accuracy;
};

struct SmoothingReport {
  Statistics lag_ms;     // over the frames; see SmoothedPose
  Statistics offset_px;  // over the frames; see SmoothedPose
  // Delay of the drawn overlay while it moves (LagMeter); nullopt if it does not move.
  std::optional<double> measured_lag_ms;
  std::optional<Evaluation> accuracy;  // errors of the drawn poses in the tracked frames
};

struct WorkReport {
  std::vector<std::pair<std::string, StageSummary>> time_ms;  // in the order of the pipeline
  std::vector<std::pair<std::string, std::int64_t>> work;
  std::map<std::string, std::int64_t> skipped;
  std::map<std::string, std::int64_t> kept;  // work reused from an earlier image
};

// One technique of a comparison. Contains times of the drawing stages only.
struct PaneReport : WorkReport {
  std::string technique;
};

struct RecordedFrames {
  std::int64_t written = 0;
  std::int64_t left_out = 0;  // frames dropped because the disk or the encoder was too slow
};

// Count of untracked frames whose reasons are equal except for the numbers in them.
struct ReasonCount {
  PoseReason first;  // the reason with the numbers of the first frame
  std::int64_t frames = 0;
};

struct RunReport : TrackingCounts, WorkReport {
  std::string recording;
  std::string scene;
  std::optional<TagsInUse> tags;  // nullopt if poses are given and no tags are needed
  std::optional<MapRefinementReport> map_refinement;  // set with --refine-map
  // Files of the refined map and camera; "": it is not written.
  std::string refined_map, refined_camera;
  std::optional<ImageFault> image_fault;  // image fault that prevents tracking, if detected
  std::optional<ResidualCauses> systematic_error;  // of the tag map, the lens or the row time
  int width = 0, height = 0;                       // [px]
  int frames = 0;                                  // processed
  int frames_captured = 0, frames_dropped = 0;
  int frames_damaged = 0;  // dropped because undecodable; other dropped frames came too late
  // Reasons why frames were not tracked, in descending order of frequency.
  std::vector<ReasonCount> reasons;
  bool interrupted = false;
  bool calibrated = true;   // false: the lens is a guess, so no frame can be tracked
  bool calibrates = false;  // the user ended a live session to calibrate the camera
  // Error that ended the run early or closed an output. Other fields are valid up to this moment.
  std::optional<Error> failure;
  std::int64_t log_lines_dropped = 0;  // because the reader of standard error stalled or ended
  int msaa_samples = 0;                // samples per pixel; 0: no multisampling
  bool pixel_buffers = false;          // pixels are transferred through pixel buffer objects
  std::string gl_renderer;
  std::string gl_version;
  // Mode of the last frame; `automatic` if no frame was drawn.
  Translucency translucency = Translucency::automatic;
  Statistics expected_overlay_px;   // predicted error (PoseEstimate) over the tracked frames
  int full_detections = 0;          // searches of whole images, also in the background
  int coarse_searches = 0;          // tracked_updates whose pattern the pyramid search found
  int box_detections = 0;           // frames with ROI detection
  int tracked_updates = 0;          // frames measured without detection
  std::int64_t pixels_sampled = 0;  // pixels sampled by alignments
  // Work that the tracker skipped, in the order of kSkippedWorkNames. --no-skip does not apply,
  // because this work would change the poses (skipped tags would not).
  std::array<std::int64_t, kSkippedWorkNames.size()> tracking_skipped{};
  std::map<std::string, std::int64_t> camera_faults;
  std::optional<RecordedFrames> recorded;  // live only; nullopt if nothing was recorded
  int threads = 1;
  std::optional<Evaluation> accuracy;        // errors of the measured poses in the tracked frames
  std::optional<SmoothingReport> smoothing;  // set if any frame was drawn with a smoothed pose
  std::vector<GroupReport> groups;           // tracked groups, in the order of the tag map
  // Panes of a comparison, in order. time_ms, work and skipped are the sums over all panes.
  std::vector<PaneReport> panes;
};

struct RunRecorderOptions {
  std::optional<CameraModel> camera;  // camera of the image, to measure the lag of smoothed poses
  bool keep_paths = false;  // keeps every frame's time and pose for an evaluation; memory use grows
};

// Collects the measurements of a run. Memory use is bounded unless paths are kept.
class RunRecorder {
 public:
  struct Group {
    GroupReport report;
    Transform<frame::Group, frame::GroupMiddle> T_group_middle;
    RunningStatistics reprojection_px;
    Trajectory tracked;  // measured T_middle_camera of tracked frames, if paths are kept
  };

  explicit RunRecorder(const RunRecorderOptions& options = {});
  // `stage`: name of a stage in the report.
  void add_time(std::string_view stage, StageTime time);
  // Adds times of the stage "gpu" for drawn frames, in any order.
  void add_gpu_times(std::span<const double> times_ms);
  // Counts a frame and adds the times of its stages.
  void add_frame(const SessionFrame& frame);
  // Adds the work of drawing a frame. A repeated drawing of a frame counts too.
  void add_work(const CompositeStats& drawn);

  [[nodiscard]] int frames() const { return report_.frames; }
  [[nodiscard]] std::optional<double> recent_ms(std::string_view stage) const;
  // The report's "work" so far.
  [[nodiscard]] std::vector<std::pair<std::string, std::int64_t>> work() const;
  // If paths are kept: times of all frames; measured and drawn poses of the tracked frames.
  [[nodiscard]] const std::vector<std::int64_t>& times_ns() const { return times_ns_; }
  [[nodiscard]] const Trajectory& tracked() const { return tracked_; }
  [[nodiscard]] const Trajectory& drawn() const { return drawn_; }
  [[nodiscard]] const Group& group(const std::string& name) const;
  // Returns the report so far. The caller fills in names and accuracy.
  [[nodiscard]] RunReport report() const;

 private:
  void add_reason(const PoseReason& reason);
  void add_tracked(const SessionFrame& frame);
  void add_group(const GroupEstimate& estimate, const TrackedFrame& tracked);

  RunReport report_;
  std::vector<std::pair<std::string, StageTimes>> stages_;
  RunningStatistics reprojection_px_;
  RunningStatistics expected_px_;  // in the tracked frames
  bool keep_paths_ = false;
  std::vector<std::int64_t> times_ns_;
  Trajectory tracked_, drawn_;
  RunningStatistics lag_ms_, offset_px_;  // over frames drawn with a smoothed pose
  std::optional<LagMeter> lag_;           // over the tracked frames among these
  std::vector<Group> groups_;
  std::vector<ReasonCount> reasons_;
  RenderCounters work_;
  std::map<SkipReason, std::int64_t> skipped_;
  std::map<KeepReason, std::int64_t> kept_;
  std::array<std::int64_t, kShadowEventNames.size()> events_{};  // indexed by ShadowEventKind
};

// Returns the errors of the run's poses (tracked() or drawn()) against the ground truth at their
// times. The run must keep its paths.
[[nodiscard]] Evaluation accuracy_of(const CameraModel& camera, const RunRecorder& run,
                                     const Trajectory& poses, const Trajectory& truth,
                                     const PairingOptions& options = {});
struct GroupTruth {
  const Trajectory& camera;  // T_table_camera
  const Trajectory& group;   // T_table_group
};
// Like accuracy_of(), for the camera's tracked poses relative to the middle of a tag group.
[[nodiscard]] Evaluation accuracy_of_group(const CameraModel& camera, const RunRecorder& run,
                                           const std::string& group, const GroupTruth& truth,
                                           const PairingOptions& options = {});

[[nodiscard]] std::string report_json(const RunReport& report);
// Returns an evaluation like the report's "accuracy"; evaluations of tag groups are in "groups".
[[nodiscard]] std::string evaluation_json(const Evaluation& evaluation,
                                          const std::map<std::string, Evaluation>& groups);

// report_table() and evaluation_table() return text tables that end with a line break.
[[nodiscard]] std::string report_table(const RunReport& report);
[[nodiscard]] std::string evaluation_table(const Evaluation& evaluation);
// Returns "3 outside the time of the ground truth, 1 in a gap ..."; empty if all are evaluated.
[[nodiscard]] std::string not_judged_text(const Evaluation& evaluation);

}  // namespace penumbra
