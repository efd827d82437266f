// What a run measured: collected frame by frame, then a JSON report or a table for people.
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

#include "app/session/pose_smoother.hpp"
#include "app/session/session.hpp"
#include "app/tags_in_use.hpp"
#include "core/error.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/evaluation/running_statistics.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/stopwatch.hpp"
#include "render/render_work.hpp"
#include "render/scene/shadow_events.hpp"
#include "tracking/detection/image_check.hpp"

namespace penumbra {

struct StageSummary {
  double median = 0.0, p95 = 0.0, max = 0.0, mean = 0.0;  // wall [ms]
  double cpu_median = 0.0, cpu_mean = 0.0;                // CPU time of the thread that did it [ms]
  std::size_t count = 0;
};

// Times of one stage over many frames.
class StageTimes {
 public:
  void add(StageTime time);
  [[nodiscard]] StageSummary summary() const;
  // Wall, mean of the last frames, kMostRecent at most [ms]; nothing before the first.
  [[nodiscard]] std::optional<double> recent_ms() const;

 private:
  static constexpr std::size_t kMostRecent = 30;
  RunningStatistics wall_ms_, cpu_ms_;
  std::array<double, kMostRecent> recent_ms_{};  // a ring
};

// Of a group of tags beside the table.
struct GroupReport {
  std::string name;
  int frames_tracked = 0, frames_uncertain = 0, frames_held = 0, frames_lost = 0;
  Statistics reprojection_rms_px;  // over the frames in which its tags were measured
  bool tags_measured = false;
  std::map<std::string, std::int64_t> tags_left_out;  // as RunReport's
  // Of the camera over the group's middle, in the tracked frames: what stands there is drawn so far
  // from where it is.
  std::optional<Evaluation> accuracy;
};

// What smoothing did to the pose that was drawn.
struct SmoothingReport {
  Statistics lag_ms;     // of each frame, as SmoothedPose's
  Statistics offset_px;  // as SmoothedPose's
  // By how much the overlay as drawn comes late where it moves, found by comparing the two paths;
  // nothing where it does not move.
  std::optional<double> measured_lag_ms;
  std::optional<Evaluation> accuracy;  // as drawn, of the tracked frames
};

// One technique of a comparison: what drawing it took, and what it did.
struct PaneReport {
  std::string technique;
  std::vector<std::pair<std::string, StageSummary>> time_ms;  // of the stages that draw
  std::vector<std::pair<std::string, std::int64_t>> work;
  std::map<std::string, std::int64_t> skipped, kept;
};

// What became of the frames of a session that went to recordings.
struct RecordedFrames {
  std::int64_t written = 0;
  std::int64_t left_out = 0;  // the disk or the encoder was too slow
};

struct RunReport {
  std::string recording;
  std::string scene;
  std::optional<TagsInUse> tags;          // nothing where poses are given without any
  std::optional<ImageFault> image_fault;  // why nothing is tracked, where that is it
  int width = 0, height = 0;              // [px]
  int frames = 0;                         // processed
  int frames_captured = 0, frames_dropped = 0;
  int frames_damaged = 0;  // of those dropped: they could not be decoded; others came too late
  int frames_tracked = 0, frames_uncertain = 0, frames_held = 0, frames_lost = 0;
  // Why frames were not tracked -> how many, the most frequent first. Numbers in a reason are an N:
  // it is one reason whatever they were.
  std::vector<std::pair<std::string, std::int64_t>> reasons;
  // The same reasons as they were in their first frame, with its numbers.
  std::map<std::string, std::string> first_reasons;
  // By id, frames in which a tag contradicted the others: it lies elsewhere than the map says.
  std::map<std::string, std::int64_t> tags_left_out;
  bool interrupted = false;
  // What ended the run early, or was not written of it; the rest is as told here.
  std::optional<Error> failure;
  std::int64_t log_lines_dropped = 0;  // not written to standard error: its reader stalled or ended
  int msaa_samples = 0;                // of each pixel; 0: no multisampling
  bool pixel_buffers = false;  // pixels go to the GPU and come from it through the driver's buffers
  std::string gl_renderer;
  std::string gl_version;
  Translucency translucency = Translucency::automatic;  // of the last frame; automatic: none drawn
  std::vector<std::pair<std::string, StageSummary>> time_ms;  // in the order of the pipeline
  Statistics reprojection_rms_px;   // over the frames in which tags were measured
  bool tags_measured = false;       // in any frame
  Statistics expected_overlay_px;   // PoseEstimate's, over the tracked frames
  int full_detections = 0;          // frames searched as a whole
  int coarse_searches = 0;          // of tracked_updates: found further off, in a smaller picture
  int box_detections = 0;           // frames searched where the tags were a moment ago
  int tracked_updates = 0;          // frames measured without such a search
  std::int64_t pixels_sampled = 0;  // by alignments
  std::vector<std::pair<std::string, std::int64_t>> work;
  std::map<std::string, std::int64_t> skipped;
  // What the tracker did not do. Its poses are the same to the bit without the tags that are
  // counted here, not with more pixels or steps: --no-skip leaves that as it is.
  std::map<std::string, std::int64_t> tracking_skipped;
  std::map<std::string, std::int64_t> kept;  // what was there from an earlier picture
  // Live only: what the camera did that it should not have, and what became of it.
  std::map<std::string, std::int64_t> camera_faults;
  std::optional<RecordedFrames> recorded;  // live only, where anything was
  // The stages that can run side by side, and which of them the others wait for.
  int threads = 1;
  std::optional<Evaluation> accuracy;        // of the tracked frames, as measured
  std::optional<SmoothingReport> smoothing;  // where any frame was drawn so
  std::vector<GroupReport> groups;           // those that were tracked, in the order of the tag map
  // Of a comparison, in the order of its panes: time_ms, work and skipped are of all together.
  std::vector<PaneReport> panes;
};

struct RunRecorderOptions {
  // Of the picture; where it is given, the lag of smoothed poses is measured.
  std::optional<CameraModel> camera;
  // Every frame's time and pose, to be compared with the truth: memory grows with the frames.
  bool keep_paths = false;
};

// Of a run of any length in bounded memory, but for the paths where they are kept.
class RunRecorder {
 public:
  explicit RunRecorder(const RunRecorderOptions& options = {});
  // `stage` is one of the report's.
  void add_time(std::string_view stage, StageTime time);
  // Of the stage "gpu": of frames that were drawn, in any order.
  void add_gpu_times(std::span<const double> times_ms);
  // Counts a frame; its stages' times are added here.
  void add_frame(const SessionFrame& frame);

  // A frame that was counted, drawn again in an edited scene: only its work is added.
  void add_redrawn(const SessionFrame& frame);

  [[nodiscard]] int frames() const { return report_.frames; }
  [[nodiscard]] std::optional<double> recent_ms(std::string_view stage) const;
  // The report's "work" so far.
  [[nodiscard]] std::vector<std::pair<std::string, std::int64_t>> work() const;
  // Where paths are kept: timestamps of the processed frames, and the poses of the tracked ones.
  [[nodiscard]] const std::vector<std::int64_t>& times_ns() const { return times_ns_; }
  [[nodiscard]] const Trajectory& tracked() const { return tracked_; }
  // The same frames, as they were drawn.
  [[nodiscard]] const Trajectory& drawn() const { return drawn_; }
  // Of the frames in which the group was tracked: T_middle_camera, as it was drawn.
  [[nodiscard]] const Trajectory& tracked_over(const std::string& group) const;
  [[nodiscard]] Transform<frame::Group, frame::GroupMiddle> middle_of(
      const std::string& group) const;
  // The report so far; names and accuracy are the caller's to fill.
  [[nodiscard]] RunReport report() const;

 private:
  struct Group {
    GroupReport report;
    Transform<frame::Group, frame::GroupMiddle> T_group_middle;
    RunningStatistics reprojection_px;
    Trajectory tracked;  // T_middle_camera; where paths are kept
  };
  void add_reason(const std::string& reason);
  void add_work(const CompositeStats& drawn);
  void add_tracked(const SessionFrame& frame);
  void add_group(const GroupEstimate& estimate, const TrackedFrame& tracked);
  [[nodiscard]] const Group& group(const std::string& name) const;

  RunReport report_;
  std::vector<std::pair<std::string, StageTimes>> stages_;
  RunningStatistics reprojection_px_;
  RunningStatistics expected_px_;  // of tracked frames
  bool keep_paths_ = false;
  std::vector<std::int64_t> times_ns_;
  Trajectory tracked_, drawn_;
  RunningStatistics lag_ms_, offset_px_;  // of frames drawn with a smoothed pose
  std::optional<LagMeter> lag_;           // of those of them that were tracked
  std::vector<Group> groups_;
  std::map<std::string, std::int64_t> reasons_;
  RenderCounters work_;
  std::array<std::int64_t, kSkipReasons> skipped_{};
  std::array<std::int64_t, kKeepReasons> kept_{};
  std::array<std::int64_t, kShadowEventNames.size()> events_{};  // by ShadowEventKind
};

// These need the paths of the run.
// The errors of the tracked poses against the truth at their times.
[[nodiscard]] Evaluation accuracy_of(const CameraModel& camera, const RunRecorder& run,
                                     const Trajectory& truth, const PairingOptions& options = {});

// The same of the poses that these frames were drawn with.
[[nodiscard]] Evaluation accuracy_as_drawn(const CameraModel& camera, const RunRecorder& run,
                                           const Trajectory& truth,
                                           const PairingOptions& options = {});

// The same of a group of tags beside the table: of the camera over its middle.
struct GroupTruth {
  const Trajectory& camera;  // T_table_camera
  const Trajectory& group;   // T_table_group
};
[[nodiscard]] Evaluation accuracy_of_group(const CameraModel& camera, const RunRecorder& run,
                                           const std::string& group, const GroupTruth& truth,
                                           const PairingOptions& options = {});

[[nodiscard]] std::string report_json(const RunReport& report);
// {"rmse", "median", "p95", "max", ...} of an evaluation, as in the report's "accuracy", with the
// counts of frames; those of groups of tags, if any, in "groups".
[[nodiscard]] std::string evaluation_json(const Evaluation& evaluation,
                                          const std::map<std::string, Evaluation>& groups = {});

// For people; ends with a line break.
[[nodiscard]] std::string report_table(const RunReport& report);
[[nodiscard]] std::string evaluation_table(const Evaluation& evaluation);
// "3 outside the time of the ground truth, 1 in a gap ..."; empty where all are judged.
[[nodiscard]] std::string not_judged_in_words(const Evaluation& evaluation);

}  // namespace penumbra
