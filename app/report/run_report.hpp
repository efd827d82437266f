// Measurements of a run: collected frame by frame, then a JSON report or a table for people.
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

namespace penumbra {

struct StageSummary {
  double median = 0.0, p95 = 0.0, max = 0.0, mean = 0.0;  // wall [ms]
  double cpu_median = 0.0, cpu_mean = 0.0;                // CPU time of the working thread [ms]
  std::size_t count = 0;
};

class StageTimes {
 public:
  void add(StageTime time);
  [[nodiscard]] StageSummary summary() const;
  // Mean wall time of the last kMostRecent frames [ms]; nothing before the first.
  [[nodiscard]] std::optional<double> recent_ms() const;

 private:
  static constexpr std::size_t kMostRecent = 30;
  RunningStatistics wall_ms_, cpu_ms_;
  std::array<double, kMostRecent> recent_ms_{};  // a ring
};

// Frames by the status of their pose, and the tags measured in them.
struct TrackingCounts {
  int frames_tracked = 0, frames_uncertain = 0, frames_held = 0, frames_lost = 0;
  Statistics reprojection_rms_px;  // over the frames in which tags were measured
  bool tags_measured = false;      // in any frame
  // By TagRejection, and by the tag's id: frames in which it was rejected.
  std::array<std::map<std::string, std::int64_t>, kTagRejections> tags_rejected;
  void add(TrackStatus status, const MeasuredTags& tags);
};

struct GroupReport : TrackingCounts {
  std::string name;
  // Errors of the camera over the group's middle, in the tracked frames.
  std::optional<Evaluation> accuracy;
};

struct SmoothingReport {
  Statistics lag_ms;     // of each frame, as SmoothedPose's
  Statistics offset_px;  // as SmoothedPose's
  // Delay of the drawn overlay while it moves (LagMeter); nothing if it does not move.
  std::optional<double> measured_lag_ms;
  std::optional<Evaluation> accuracy;  // of the drawn poses in the tracked frames
};

struct WorkReport {
  std::vector<std::pair<std::string, StageSummary>> time_ms;  // in the order of the pipeline
  std::vector<std::pair<std::string, std::int64_t>> work;
  std::map<std::string, std::int64_t> skipped;
  std::map<std::string, std::int64_t> kept;  // reused from an earlier image
};

// One technique of a comparison. Its times are of the stages that draw.
struct PaneReport : WorkReport {
  std::string technique;
};

struct RecordedFrames {
  std::int64_t written = 0;
  std::int64_t left_out = 0;  // the disk or the encoder was too slow
};

// Untracked frames whose reasons differ only in their numbers.
struct ReasonCount {
  std::int64_t frames = 0;
  PoseReason first;  // with the numbers of the first frame
};

struct RunReport : TrackingCounts, WorkReport {
  std::string recording;
  std::string scene;
  std::optional<TagsInUse> tags;          // nothing if poses are given without any
  std::optional<ImageFault> image_fault;  // the reason why nothing is tracked, if it is one
  int width = 0, height = 0;              // [px]
  int frames = 0;                         // processed
  int frames_captured = 0, frames_dropped = 0;
  int frames_damaged = 0;  // of those dropped: they could not be decoded; others came too late
  // Reasons why frames were not tracked, the most frequent first. Numbers in a reason are replaced
  // by N, so that it counts as one.
  std::vector<std::pair<std::string, ReasonCount>> reasons;
  bool interrupted = false;
  // The error that ended the run early, or that closed an output; the rest is as reported here.
  std::optional<Error> failure;
  std::int64_t log_lines_dropped = 0;  // the reader of standard error stalled or ended
  int msaa_samples = 0;                // of each pixel; 0: no multisampling
  bool pixel_buffers = false;          // pixels are transferred through the driver's buffers
  std::string gl_renderer;
  std::string gl_version;
  // The last frame's mode; automatic: no frame was drawn.
  Translucency translucency = Translucency::automatic;
  Statistics expected_overlay_px;   // PoseEstimate's, over the tracked frames
  int full_detections = 0;          // frames searched as a whole
  int coarse_searches = 0;          // of tracked_updates: found by the pyramid search
  int box_detections = 0;           // frames searched by ROI detection
  int tracked_updates = 0;          // frames measured without such a search
  std::int64_t pixels_sampled = 0;  // by alignments
  // Work that the tracker skipped. Only skipped tags leave the poses the same to the bit, so
  // --no-skip does not apply to it.
  std::map<std::string, std::int64_t> tracking_skipped;
  std::map<std::string, std::int64_t> camera_faults;
  std::optional<RecordedFrames> recorded;  // live only, if anything was
  int threads = 1;
  std::optional<Evaluation> accuracy;        // of the tracked frames, as measured
  std::optional<SmoothingReport> smoothing;  // if any frame was drawn with a smoothed pose
  std::vector<GroupReport> groups;           // those that were tracked, in the order of the tag map
  // The panes of a comparison in their order; time_ms, work and skipped are the sums of all.
  std::vector<PaneReport> panes;
};

struct RunRecorderOptions {
  std::optional<CameraModel> camera;  // of the image; with it the lag of smoothed poses is measured
  bool keep_paths = false;  // every frame's time and pose, for an evaluation: memory grows
};

// Collects the measurements of a run in bounded memory, except for the paths.
class RunRecorder {
 public:
  struct Group {
    GroupReport report;
    Transform<frame::Group, frame::GroupMiddle> T_group_middle;
    RunningStatistics reprojection_px;
    Trajectory tracked;  // T_middle_camera as drawn, if paths are kept
  };

  explicit RunRecorder(const RunRecorderOptions& options = {});
  // `stage` is one of the report's.
  void add_time(std::string_view stage, StageTime time);
  // Times of the stage "gpu", of drawn frames in any order.
  void add_gpu_times(std::span<const double> times_ms);
  // Counts a frame and adds the times of its stages.
  void add_frame(const SessionFrame& frame);
  // Adds the work of drawing, also of a counted frame that is drawn again.
  void add_work(const CompositeStats& drawn);

  [[nodiscard]] int frames() const { return report_.frames; }
  [[nodiscard]] std::optional<double> recent_ms(std::string_view stage) const;
  // The report's "work" so far.
  [[nodiscard]] std::vector<std::pair<std::string, std::int64_t>> work() const;
  // If paths are kept: timestamps of the processed frames, and the poses of the tracked ones.
  [[nodiscard]] const std::vector<std::int64_t>& times_ns() const { return times_ns_; }
  [[nodiscard]] const Trajectory& tracked() const { return tracked_; }
  [[nodiscard]] const Trajectory& drawn() const { return drawn_; }
  [[nodiscard]] const Group& group(const std::string& name) const;
  // The report so far; names and accuracy are the caller's to fill.
  [[nodiscard]] RunReport report() const;

 private:
  void add_reason(const PoseReason& reason);
  void add_tracked(const SessionFrame& frame);
  void add_group(const GroupEstimate& estimate, const TrackedFrame& tracked);

  RunReport report_;
  std::vector<std::pair<std::string, StageTimes>> stages_;
  RunningStatistics reprojection_px_;
  RunningStatistics expected_px_;  // of tracked frames
  bool keep_paths_ = false;
  std::vector<std::int64_t> times_ns_;
  Trajectory tracked_, drawn_;
  RunningStatistics lag_ms_, offset_px_;  // of frames drawn with a smoothed pose
  std::optional<LagMeter> lag_;           // of those that were tracked
  std::vector<Group> groups_;
  std::map<std::string, ReasonCount> reasons_;
  RenderCounters work_;
  std::map<SkipReason, std::int64_t> skipped_;
  std::map<KeepReason, std::int64_t> kept_;
  std::array<std::int64_t, kShadowEventNames.size()> events_{};  // by ShadowEventKind
};

// Errors of poses of the run's frames (tracked() or drawn()) against the truth at their times. The
// run keeps its paths.
[[nodiscard]] Evaluation accuracy_of(const CameraModel& camera, const RunRecorder& run,
                                     const Trajectory& poses, const Trajectory& truth,
                                     const PairingOptions& options = {});
// The same of the camera over the middle of a group of tags beside the table.
struct GroupTruth {
  const Trajectory& camera;  // T_table_camera
  const Trajectory& group;   // T_table_group
};
[[nodiscard]] Evaluation accuracy_of_group(const CameraModel& camera, const RunRecorder& run,
                                           const std::string& group, const GroupTruth& truth,
                                           const PairingOptions& options = {});

[[nodiscard]] std::string report_json(const RunReport& report);
// An evaluation as in the report's "accuracy"; those of groups of tags, if any, are in "groups".
[[nodiscard]] std::string evaluation_json(const Evaluation& evaluation,
                                          const std::map<std::string, Evaluation>& groups);

// For people; ends with a line break.
[[nodiscard]] std::string report_table(const RunReport& report);
[[nodiscard]] std::string evaluation_table(const Evaluation& evaluation);
// "3 outside the time of the ground truth, 1 in a gap ..."; empty if all are judged.
[[nodiscard]] std::string not_judged_in_words(const Evaluation& evaluation);

}  // namespace penumbra
