// What a run measured: collected frame by frame, then a JSON report or a table for people.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/session.hpp"
#include "core/evaluation.hpp"
#include "core/group_pose.hpp"
#include "core/stopwatch.hpp"
#include "render/shadow/shadow_node.hpp"

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
  // Wall, mean of the last `count` frames [ms]; nothing before the first.
  [[nodiscard]] std::optional<double> recent_ms(std::size_t count) const;

 private:
  std::vector<double> wall_ms_;
  std::vector<double> cpu_ms_;
};

// Of a group of tags beside the table.
struct GroupReport {
  std::string name;
  int frames_tracked = 0, frames_uncertain = 0, frames_held = 0, frames_lost = 0;
  Statistics reprojection_rms_px;  // over the frames in which its tags were measured
  bool tags_measured = false;
  // Of the camera over the group's middle, in the tracked frames: what stands there is drawn so far
  // from where it is.
  std::optional<Evaluation> accuracy;
};

// One technique of a comparison: what drawing it took, and what it did.
struct PaneReport {
  std::string technique;
  std::vector<std::pair<std::string, StageSummary>> time_ms;  // of the stages that draw
  std::vector<std::pair<std::string, std::int64_t>> work;
  std::map<std::string, std::int64_t> skipped;
};

struct RunReport {
  std::string recording;
  std::string scene;
  int width = 0, height = 0;  // [px]
  int frames = 0;             // processed
  int frames_captured = 0, frames_dropped = 0;
  int frames_tracked = 0, frames_uncertain = 0, frames_held = 0, frames_lost = 0;
  bool interrupted = false;
  std::string gl_renderer;
  std::string gl_version;
  std::vector<std::pair<std::string, StageSummary>> time_ms;  // in the order of the pipeline
  Statistics reprojection_rms_px;   // over the frames in which tags were measured
  bool tags_measured = false;       // in any frame
  int full_detections = 0;          // frames searched as a whole
  int tracked_updates = 0;          // frames measured without such a search
  std::int64_t pixels_sampled = 0;  // by alignments
  std::vector<std::pair<std::string, std::int64_t>> work;
  std::map<std::string, std::int64_t> skipped;
  // Live only: what the camera did that it should not have, and what became of it.
  std::map<std::string, std::int64_t> camera_faults;
  // The stages that can run side by side, and which of them the others wait for.
  int threads = 1;
  std::optional<Evaluation> accuracy;  // of the tracked frames
  std::vector<GroupReport> groups;     // those that were tracked, in the order of the tag map
  // Of a comparison, in the order of its panes: time_ms, work and skipped are of all together.
  std::vector<PaneReport> panes;
};

class RunRecorder {
 public:
  RunRecorder();
  // `stage` is one of the report's.
  void add_time(std::string_view stage, StageTime time);
  // Counts a frame; its stages' times are added here.
  void add_frame(const SessionFrame& frame);

  // A frame that was counted, drawn again in an edited scene: only its work is added.
  void add_redrawn(const SessionFrame& frame);

  [[nodiscard]] int frames() const { return report_.frames; }
  [[nodiscard]] std::optional<double> recent_ms(std::string_view stage, std::size_t count) const;
  // The report's "work" so far.
  [[nodiscard]] std::vector<std::pair<std::string, std::int64_t>> work() const;
  // Timestamps of the processed frames, and the poses of the tracked ones.
  [[nodiscard]] const std::vector<std::int64_t>& times_ns() const { return times_ns_; }
  [[nodiscard]] const Trajectory& tracked() const { return tracked_; }
  // Of the frames in which the group was tracked: T_middle_camera, as it was drawn.
  [[nodiscard]] const Trajectory& tracked_over(const std::string& group) const;
  [[nodiscard]] Transform<frame::Group, frame::GroupMiddle> middle_of(
      const std::string& group) const;
  // The report so far; names and accuracy are the caller's to fill.
  [[nodiscard]] RunReport report() const;

 private:
  struct Work {
    std::int64_t shadow_vertices = 0, kernel_generations = 0, reprojections = 0,
                 triples_recomputed = 0, proxy_shadows = 0, proxy_checks = 0, proxy_faces_saved = 0,
                 masks_drawn = 0, masks_kept = 0, faces_tested = 0, faces_twisted = 0,
                 passes_drawn = 0, passes_skipped = 0;
  };
  struct Group {
    GroupReport report;
    Transform<frame::Group, frame::GroupMiddle> T_group_middle;
    std::vector<double> reprojection_px;
    Trajectory tracked;  // T_middle_camera
  };
  void add_work(const CompositeStats& drawn);
  void add_group(const GroupEstimate& estimate, const TrackedFrame& tracked);
  [[nodiscard]] const Group& group(const std::string& name) const;

  RunReport report_;
  std::vector<std::pair<std::string, StageTimes>> stages_;
  std::vector<double> reprojection_px_;
  std::vector<std::int64_t> times_ns_;
  Trajectory tracked_;
  std::vector<Group> groups_;
  Work work_;
  std::array<std::int64_t, kShadowEventNames.size()> events_{};  // by ShadowEventKind
};

// The errors of the tracked poses against those true poses that belong to processed frames.
[[nodiscard]] Evaluation accuracy_of(const CameraModel& camera, const RunRecorder& run,
                                     const Trajectory& truth);

// The same of a group of tags beside the table: of the camera over its middle. `group_truth`:
// T_table_group.
[[nodiscard]] Evaluation accuracy_of_group(const CameraModel& camera, const RunRecorder& run,
                                           const std::string& group, const Trajectory& truth,
                                           const Trajectory& group_truth);

[[nodiscard]] std::string report_json(const RunReport& report);
// {"rmse", "median", "p95", "max", ...} of an evaluation, as in the report's "accuracy", with the
// counts of frames.
[[nodiscard]] std::string evaluation_json(const Evaluation& evaluation);

// For people; ends with a line break.
[[nodiscard]] std::string report_table(const RunReport& report);
[[nodiscard]] std::string evaluation_table(const Evaluation& evaluation);

}  // namespace penumbra
