#include "app/replay/replay_run.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <map>
#include <memory>
#include <span>
#include <thread>
#include <utility>
#include <vector>

#include "app/capture/capture_stats.hpp"
#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/late_outputs.hpp"
#include "app/output/run_outputs.hpp"
#include "app/progress.hpp"
#include "app/recording/look_ahead.hpp"
#include "app/recording/recording_source.hpp"
#include "app/replay/comparison.hpp"
#include "app/report/versions.hpp"
#include "app/session/image_fault_watch.hpp"
#include "app/session/scene_edit.hpp"
#include "app/session/session.hpp"
#include "app/session/session_host.hpp"
#include "app/standard_streams.hpp"
#include "app/window/overlay.hpp"
#include "app/window/viewer.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"
#include "render/gl/framebuffer.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

// How far tracking runs ahead of drawing, and drawing ahead of encoding [frames].
constexpr int kTrackAhead = 2;
constexpr int kEncodeAhead = 2;

struct TrackedItem {
  TrackedFrame tracked;
  StageTime capture_time;
};
using TrackAhead = LookAhead<TrackedItem>;

// No output may take the place of what this run reads, or of another output. A recording is only
// read: nothing is written anywhere in its folder.
Result<void> check_outputs(const ReplayRequest& request, const Recording& recording) {
  std::vector<fs::path> taken = {request.scene};
  if (request.kernel_file) taken.push_back(*request.kernel_file);
  if (request.tags) taken.push_back(*request.tags);
  for (const fs::path& file : files_of(recording)) taken.push_back(file);
  if (request.poses_from) taken.emplace_back(*request.poses_from);
  PENUMBRA_TRY_VOID(check_apart_from(recording, request));
  return check_output_paths(request, std::move(taken));
}

// Shows frames at the pace they were recorded.
class Pacer {
 public:
  void wait_for(std::int64_t timestamp_ns, double paused_ms) {
    if (!started_) {
      started_ = true;
      first_ns_ = timestamp_ns;
      start_.restart();
    }
    const double due_ms = static_cast<double>(timestamp_ns - first_ns_) * 1e-6 + paused_ms;
    const double early_ms = due_ms - start_.elapsed().wall_ms;
    if (early_ms > 0.0) {
      std::this_thread::sleep_for(std::chrono::duration<double, std::milli>(early_ms));
    }
  }

 private:
  bool started_ = false;
  std::int64_t first_ns_ = 0;
  Stopwatch start_;
};

// What a person changed in the scene while it was recorded happens again, at the same frames.
class RecordedEdits {
 public:
  RecordedEdits(const Recording& recording, const SceneEvents& events, const fs::path& scene)
      : file_(recording.folder / "events.jsonl"), scene_(scene), events_(events.edits) {}

  // `shown`: the session, or several in comparison.
  template <class Shown>
  void replay_until(std::int64_t timestamp_ns, Shown& shown) {
    for (; next_ < events_.size() && events_[next_].timestamp_ns <= timestamp_ns; ++next_) {
      if (shown.replay_edit(events_[next_].edit) || warned_) continue;
      warned_ = true;
      log_warning("{}: changes what is not in {}; such changes are left out", file_.string(),
                  scene_.string());
    }
  }

 private:
  fs::path file_;
  fs::path scene_;
  const std::vector<SceneEvent>& events_;
  std::size_t next_ = 0;
  bool warned_ = false;
};

Result<void> check_range(const ReplayRequest& request, const Recording& recording) {
  const int first = recording.frames.front().number;
  const int last = recording.frames.back().number;
  const bool past = request.frames.last && *request.frames.last > last + 1;
  if (request.frames.first > last || (request.frames.last && *request.frames.last <= first)) {
    return fail("{}: has no frame in --frames {}:{}; its frames are {} to {}",
                recording.folder.string(), request.frames.first,
                request.frames.last ? std::to_string(*request.frames.last) : "", first, last);
  }
  if (past) {
    log_warning("{}: --frames ends at {}, but the last frame is {}", recording.folder.string(),
                *request.frames.last, last);
  }
  return {};
}

// Where in the listing the first frame with this number or a greater one is: a recording that lost
// frames has gaps in its numbers.
int place_of(const Recording& recording, int number) {
  const auto found = std::lower_bound(
      recording.frames.begin(), recording.frames.end(), number,
      [](const RecordedFrame& frame, int wanted) { return frame.number < wanted; });
  return static_cast<int>(found - recording.frames.begin());
}

// What is drawn: one session, or several side by side.
class Shown {
 public:
  [[nodiscard]] static Result<Shown> open(const ReplayRequest& request, GlContext& context,
                                          const std::shared_ptr<const Scene>& scene,
                                          const CameraModel& camera, PoseSource poses,
                                          const SessionOptions& options) {
    Shown shown;
    if (request.compare.empty()) {
      PENUMBRA_TRY(auto session,
                   Session::create(context, scene, camera, std::move(poses), options));
      shown.session_ = std::make_unique<Session>(std::move(session));
    } else {
      PENUMBRA_TRY(auto comparison, Comparison::create(context, scene, camera, std::move(poses),
                                                       request.compare, options));
      shown.comparison_ = std::make_unique<Comparison>(std::move(comparison));
    }
    return shown;
  }

  [[nodiscard]] TrackedFrame track(const Frame& frame) {
    return comparison_ ? comparison_->track(frame) : session_->track(frame);
  }
  [[nodiscard]] Result<SessionFrame> draw(TrackedFrame tracked, bool read_back) {
    if (comparison_) return comparison_->draw(tracked);
    if (!read_back) {
      pixels_.clear();
    } else if (pixels_.empty()) {
      const CameraModel& camera = session_->camera();
      pixels_.resize(std::size_t{4} * static_cast<std::size_t>(camera.width()) *
                     static_cast<std::size_t>(camera.height()));
    }
    return session_->draw(std::move(tracked), pixels_, PictureTime::later);
  }
  // What draw() read back: the last picture, or the one before it (SessionFrame::picture).
  [[nodiscard]] std::span<const std::uint8_t> pixels() const {
    return comparison_ ? comparison_->grid().rgba() : std::span<const std::uint8_t>(pixels_);
  }
  bool replay_edit(const SceneEdit& edit) {
    return comparison_ ? comparison_->replay_edit(edit) : session_->replay_edit(edit);
  }
  // Null in comparison, whose pictures are there as soon as they are drawn.
  [[nodiscard]] Session* session() { return session_.get(); }
  [[nodiscard]] bool pixel_buffers() const {
    return comparison_ ? comparison_->pixel_buffers() : session_->pixel_buffers();
  }
  void take_gpu_times(RunRecorder& run) {
    if (comparison_) {
      comparison_->take_gpu_times();
    } else {
      run.add_gpu_times(session_->take_gpu_times());
    }
  }
  [[nodiscard]] int samples() const {
    return comparison_ ? comparison_->samples() : session_->samples();
  }
  [[nodiscard]] std::vector<PaneReport> pane_reports() const {
    return comparison_ ? comparison_->reports() : std::vector<PaneReport>();
  }

  // For a window; kept here.
  [[nodiscard]] Result<ViewerHost*> open_host(GlContext& context, RunRecorder& run,
                                              const Recording& recording) {
    const int frame_count = static_cast<int>(recording.frames.size());
    if (!comparison_) {
      session_host_ = std::make_unique<SessionHost>(*session_, run, frame_count);
      session_host_->keep_out_of(recording.folder);
      return session_host_.get();
    }
    const PaneGrid& grid = comparison_->grid();
    PENUMBRA_TRY(auto picture, UploadedPicture::create(grid.width(), grid.height()));
    comparison_host_ = std::make_unique<ComparisonHost>(*comparison_, context, std::move(picture),
                                                        run, frame_count);
    comparison_host_->keep_out_of(recording.folder);
    return comparison_host_.get();
  }
  void saw(const SessionFrame& frame) {
    if (session_host_) session_host_->saw(frame);
    if (comparison_host_) comparison_host_->saw(frame);
  }

 private:
  Shown() = default;
  std::unique_ptr<Session> session_;
  std::unique_ptr<Comparison> comparison_;
  std::vector<std::uint8_t> pixels_;
  std::unique_ptr<SessionHost> session_host_;
  std::unique_ptr<ComparisonHost> comparison_host_;
};

GlContext::Size picture_size(const ReplayRequest& request, const CameraModel& camera) {
  if (request.compare.empty()) return {camera.width(), camera.height()};
  const GridSize size =
      grid_size(camera.width(), camera.height(), static_cast<int>(request.compare.size()));
  return {size.width, size.height};
}

// A grid of panes may be larger than any screen.
GlContext::Size window_size_for(GlContext::Size picture) {
  constexpr double kWidest = 1600.0;
  constexpr double kTallest = 960.0;
  const double scale = std::min({1.0, kWidest / picture.width, kTallest / picture.height});
  return {static_cast<int>(scale * picture.width), static_cast<int>(scale * picture.height)};
}

}  // namespace

Result<PoseSource> open_replay_poses(const ReplayRequest& request, const Recording& recording,
                                     const Scene& scene) {
  const fs::path tags = request.tags.value_or(recording.folder / "tags.yaml");
  if (!request.poses_from) {
    TrackerOptions tracking = request.tracking;
    tracking.search_thread = request.threads > 1;
    auto tracker = GroupTracker::create(
        *recording.camera, *recording.tags, tracking,
        wanted_groups(scene, *recording.tags, tags, request, request.plan.skip));
    if (!tracker) return fail_in(tags.string(), tracker.error());
    return PoseSource(std::move(*tracker));
  }
  if (recording.tags) {
    warn_of_unknown_groups(scene, *recording.tags, tags, "it stays where the scene has it");
  }
  if (*request.poses_from == "groundtruth") {
    if (!recording.groundtruth) {
      return fail(
          "{}: there is no such file; give --poses-from a TUM file, or leave it out to track",
          (recording.folder / "groundtruth.tum").string());
    }
    return PoseSource(GivenPoses{*recording.groundtruth, recording.group_groundtruth});
  }
  PENUMBRA_TRY(auto trajectory, load_trajectory(*request.poses_from));
  const bool any = std::any_of(
      recording.frames.begin(), recording.frames.end(),
      [&](const RecordedFrame& frame) { return trajectory.at(frame.timestamp_ns) != nullptr; });
  if (!any) {
    return fail("{}: has no pose within 1 ms of any frame of {}; is it of another recording?",
                *request.poses_from, recording.folder.string());
  }
  // Groups as they were tracked together with these poses; else where they truly are.
  std::map<std::string, Trajectory> groups = recording.group_groundtruth;
  if (recording.tags) {
    PENUMBRA_TRY(auto tracked,
                 load_group_paths(fs::path(*request.poses_from).parent_path() / kGroupPosesFolder,
                                  other_groups(*recording.tags)));
    for (auto& [group, path] : tracked) groups.insert_or_assign(group, std::move(path));
  }
  return PoseSource(GivenPoses{std::move(trajectory), std::move(groups)});
}

double frame_interval_s(const Recording& recording) {
  std::vector<std::int64_t> gaps;
  for (std::size_t i = 1; i < recording.frames.size(); ++i) {
    gaps.push_back(recording.frames[i].timestamp_ns - recording.frames[i - 1].timestamp_ns);
  }
  if (gaps.empty()) return 1.0 / 30.0;
  const auto middle = gaps.begin() + static_cast<std::ptrdiff_t>(gaps.size() / 2);
  std::nth_element(gaps.begin(), middle, gaps.end());
  return std::clamp(seconds(*middle), 1e-4, 10.0);
}

namespace {

// Warns before the run where the ground truth can't judge it. The job does not need it.
void check_groundtruth(const ReplayRequest& request, const Recording& recording) {
  if (!recording.groundtruth) return;
  Trajectory frames;
  for (const RecordedFrame& frame : recording.frames)
    frames.poses.push_back({frame.timestamp_ns, {}, {}});
  const auto units =
      check_units_of_time({frames, recording.folder.string()},
                          {*recording.groundtruth, "its ground truth"}, request.pairing);
  if (!units) {
    log_warning("{}", units.error().message);
    return;
  }
  for (const std::string& warning : *units) log_warning("{}", warning);
}

void add_accuracy(const ReplayRequest& request, const Recording& recording, const RunRecorder& run,
                  RunReport& report) {
  if (!recording.groundtruth) return;
  const CameraModel& camera = *recording.camera;
  const Trajectory& truth = *recording.groundtruth;
  const Evaluation accuracy = accuracy_of(camera, run, truth, request.pairing);
  if (accuracy.frames_with_truth > 0) {
    report.accuracy = accuracy;
  } else {
    log_warning(
        "{}: its ground truth has no pose at the time of any frame; see --time-offset and "
        "--max-gap",
        recording.folder.string());
  }
  if (report.smoothing) {
    report.smoothing->accuracy = accuracy_as_drawn(camera, run, truth, request.pairing);
  }
  for (GroupReport& group : report.groups) {
    const auto places = recording.group_groundtruth.find(group.name);
    if (places == recording.group_groundtruth.end()) continue;
    const Evaluation of_group =
        accuracy_of_group(camera, run, group.name, {truth, places->second}, request.pairing);
    if (of_group.frames_with_truth > 0) group.accuracy = of_group;
  }
}

}  // namespace

Result<RunReport> run_replay(const ReplayRequest& request) {
  InterruptWatch interrupt;  // first: decoders and OpenGL start threads

  OpenRecordingOptions open_options;
  open_options.tags = request.tags;
  open_options.camera_name = request.camera_name;
  open_options.require_tags = !request.poses_from;  // given poses need no tags
  PENUMBRA_TRY(auto recording, open_recording(request.recording, open_options));
  for (const std::string& notice : recording.notices) log_warning("{}", notice);
  PENUMBRA_TRY_VOID(check_range(request, recording));
  check_groundtruth(request, recording);
  const CameraModel& camera = *recording.camera;

  std::optional<TagsInUse> tags;
  std::optional<ImageFaultWatch> pictures;
  if (recording.tags) {
    tags = tags_in_use(request.tags.value_or(recording.folder / "tags.yaml"), *recording.tags);
    if (!request.poses_from) pictures.emplace(*recording.tags);
  }
  PENUMBRA_TRY(auto loaded_scene, load_run_scene(request.scene, request.kernel_file));
  const auto scene = std::make_shared<const Scene>(std::move(loaded_scene));
  PENUMBRA_TRY(auto poses, open_replay_poses(request, recording, *scene));
  std::vector<PlanOptions> plans;
  for (const ComparedTechnique& pane : request.compare) plans.push_back(pane.plan);
  if (plans.empty()) plans.push_back(request.plan);
  tell_warnings(*scene, plans);

  auto events = load_scene_events(recording.folder / "events.jsonl");
  if (!request.edits) {
    SceneEvents without;
    if (events) {
      without.lights = std::move(events->lights);
    } else {
      log_warning("{}; the light is measured anew", events.error().message);
    }
    events = std::move(without);
  }
  if (!events) return tl::unexpected(events.error());

  PENUMBRA_TRY_VOID(check_outputs(request, recording));

  RecordingSourceOptions source_options;
  source_options.first = place_of(recording, request.frames.first);
  if (request.frames.last) source_options.last = place_of(recording, *request.frames.last);
  if (source_options.last && *source_options.last <= source_options.first) {
    return fail("{}: has no frame in --frames {}:{}", recording.folder.string(),
                request.frames.first, *request.frames.last);
  }
  const bool overlapped = request.threads > 1;
  if (!overlapped) source_options.look_ahead = 0;
  PENUMBRA_TRY(auto source, open_recording_source(recording, source_options));

  const GlContext::Size picture = picture_size(request, camera);
  PENUMBRA_TRY(auto context, open_run_context({request.window, true}, window_size_for(picture)));
  if (pictures) print_tags(*tags);
  log_info("OpenGL: {}, {}", context->info().renderer, context->info().version);
  for (const auto& [name, version] : component_versions()) log_info("{} {}", name, version);
  SessionOptions session_options;
  session_options.plan = request.plan;
  session_options.rectified = request.rectified;
  session_options.video_light = request.video_light;
  session_options.msaa = request.msaa;
  session_options.pixel_buffers = request.pixel_buffers;
  session_options.smooth = request.smooth;
  session_options.recorded_light = std::move(events->lights);
  session_options.scene_start_ns =
      events->scene_start_ns.value_or(recording.frames.front().timestamp_ns);
  PENUMBRA_TRY(auto shown,
               Shown::open(request, *context, scene, camera, std::move(poses), session_options));

  interrupt.hold();
  const std::vector<std::string> groups =
      recording.tags ? other_groups(*recording.tags) : std::vector<std::string>();
  auto outputs = open_outputs(request, {picture.width, picture.height, frame_interval_s(recording)},
                              groups, overlapped ? kEncodeAhead : 0);
  if (!outputs) return tl::unexpected(outputs.error());

  RunRecorder run({camera, recording.groundtruth.has_value()});
  const bool has_window = context->window_size().width > 0;
  std::optional<Viewer> viewer;
  if (has_window) {
    PENUMBRA_TRY(auto overlay, Overlay::create(*context));
    PENUMBRA_TRY(auto host, shown.open_host(*context, run, recording));
    viewer.emplace(*context, *host, std::move(overlay), request.viewer);
  }
  LateOutputs late(shown.session(), *outputs, run);
  RecordedEdits edits(recording, *events, request.scene);
  Pacer pacer;
  // The next frames are tracked while this one is drawn and the one before it encoded; each stage
  // takes the frames in order, so that nothing depends on which thread was faster.
  TrackAhead tracked(
      [&]() -> TrackAhead::Item {
        PENUMBRA_TRY(auto frame, source->next());
        if (!frame) return std::optional<TrackedItem>();
        TrackedFrame done = shown.track(*frame);
        if (pictures) pictures->saw(done);
        return std::optional<TrackedItem>({std::move(done), source->capture_time()});
      },
      overlapped ? kTrackAhead : 0);
  bool stopped = false;
  // What can't be written is given up, and the rest goes on. What can't be read or drawn ends the
  // run: nothing takes the place of what an earlier one made.
  std::optional<Error> failure;
  // An error of the run comes first.
  const auto end_with = [&](const Error& error) -> tl::unexpected<Error> {
    if (const auto rest = late.write_rest(); !rest) log_warning("{}", rest.error().message);
    return tl::unexpected(error);
  };
  {
    ProgressBar progress(source->frame_count().value_or(0));
    while (!stopped) {
      const Stopwatch frame_watch;
      auto item = tracked.next();
      if (!item) return end_with(item.error());
      if (!*item) break;
      run.add_time("capture", (*item)->capture_time);
      const std::uint64_t sequence = (*item)->tracked.frame.sequence;
      const std::int64_t timestamp_ns = (*item)->tracked.frame.timestamp_ns;
      edits.replay_until(timestamp_ns, shown);

      auto done = shown.draw(std::move((*item)->tracked), outputs->frames != nullptr);
      if (!done) return end_with(done.error());
      run.add_frame(*done);
      const PoseEstimate& pose = done->tracked.pose;
      log_debug("frame {}: {}{}{}", sequence, to_string(pose.status),
                pose.reason.empty() ? "" : ": ", pose.reason);

      if (auto written = late.write(*done, shown.pixels()); !written) {
        if (!failure) failure = written.error();
        stopped = !outputs->any() && !outputs->report && !has_window;
        if (!stopped)
          log_warning("{}; this output is closed, the replay continues", written.error().message);
      }
      run.add_time("frame", frame_watch.elapsed());
      progress.update(run.frames());

      if (request.realtime || has_window) {
        pacer.wait_for(timestamp_ns, viewer ? viewer->paused_ms() : 0.0);
      }
      if (viewer) {
        shown.saw(*done);
        stopped = !viewer->show(interrupt) || stopped;
      }
      stopped = interrupt.interrupted() || stopped;
    }
  }
  if (!failure) failure = display_loss(*context);
  if (run.frames() == 0) {
    return fail("{}: no frame was replayed", recording.folder.string());
  }

  if (auto rest = late.write_rest(); !rest && !failure) failure = rest.error();
  if (auto finished = outputs->finish(run); !finished && !failure) failure = finished.error();
  shown.take_gpu_times(run);
  RunReport report = run.report();
  report.threads = overlapped ? request.threads : 1;
  report.recording = request.recording.string();
  report.scene = request.scene.string();
  report.tags = std::move(tags);
  if (pictures) report.image_fault = pictures->fault();
  report.width = picture.width;
  report.height = picture.height;
  report.panes = shown.pane_reports();
  if (const std::int64_t damaged = source->damaged(); damaged > 0) {
    report.camera_faults[std::string(name_of(CaptureFault::damaged))] = damaged;
    // As live counted them.
    report.frames_damaged = report.frames_dropped = static_cast<int>(damaged);
    report.frames_captured = report.frames + report.frames_damaged;
  }
  report.interrupted = interrupt.interrupted();
  report.log_lines_dropped = dropped_log_lines();
  report.msaa_samples = shown.samples();
  report.pixel_buffers = shown.pixel_buffers();
  report.gl_renderer = context->info().renderer;
  report.gl_version = context->info().version;
  add_accuracy(request, recording, run, report);
  report.failure = std::move(failure);
  if (auto written = outputs->write_report(report); !written && !report.failure) {
    report.failure = written.error();
  }
  return report;
}

}  // namespace penumbra
