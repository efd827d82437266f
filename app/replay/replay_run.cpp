#include "app/replay/replay_run.hpp"

#include <algorithm>
#include <chrono>
#include <memory>
#include <thread>
#include <utility>

#include "app/capture/capture_stats.hpp"
#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/run_outputs.hpp"
#include "app/progress.hpp"
#include "app/recording/look_ahead.hpp"
#include "app/recording/recording_source.hpp"
#include "app/replay/replay_poses.hpp"
#include "app/replay/replay_view.hpp"
#include "app/report/versions.hpp"
#include "app/run/refined_files.hpp"
#include "app/run/run_scene.hpp"
#include "app/run_inputs.hpp"
#include "app/session/image_fault_watch.hpp"
#include "app/session/map_refinement.hpp"
#include "app/session/scene_edit.hpp"
#include "app/standard_streams.hpp"
#include "app/window/overlay.hpp"
#include "app/window/viewer.hpp"
#include "calib/refinement/residual_watch.hpp"
#include "core/camera/camera_file.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

constexpr int kTrackAhead = 2;   // queue length between tracking and drawing [frames]
constexpr int kEncodeAhead = 2;  // queue length between drawing and encoding [frames]

// Fails if an output would replace an input or another output, or lies in the recording's folder.
Result<void> check_outputs(const ReplayRequest& request, const Recording& recording,
                           const Scene& scene) {
  std::vector<fs::path> taken = {request.scene};
  if (request.kernel_file) taken.push_back(*request.kernel_file);
  for (fs::path& file : model_files(scene)) taken.push_back(std::move(file));
  if (request.tags) taken.push_back(*request.tags);
  taken.push_back(recording.camera_file);
  for (const fs::path& file : files_of(recording)) taken.push_back(file);
  if (request.poses_from) taken.emplace_back(*request.poses_from);
  PENUMBRA_TRY_VOID(check_apart_from(recording, request));
  return check_output_paths(request, std::move(taken));
}

// Shows frames at the rate at which they were recorded.
class Pacer {
 public:
  void wait_for(std::int64_t timestamp_ns, double paused_ms) {
    if (!first_ns_) {
      first_ns_ = timestamp_ns;
      start_.restart();
    }
    const double due_ms = static_cast<double>(timestamp_ns - *first_ns_) * 1e-6 + paused_ms;
    const double early_ms = due_ms - start_.elapsed().wall_ms;
    if (early_ms > 0.0) {
      std::this_thread::sleep_for(std::chrono::duration<double, std::milli>(early_ms));
    }
  }

 private:
  std::optional<std::int64_t> first_ns_;
  Stopwatch start_;
};

// Repeats the edits of the recorded session at the same frames.
class RecordedEdits {
 public:
  RecordedEdits(const Recording& recording, const SceneEvents& events, const fs::path& scene)
      : file_(recording.folder / "events.jsonl"), scene_(scene), events_(events.edits) {}

  void replay_until(std::int64_t timestamp_ns, ReplayView& view) {
    for (; next_ < events_.size() && events_[next_].timestamp_ns <= timestamp_ns; ++next_) {
      if (view.replay_edit(events_[next_].edit) || warned_) continue;
      warned_ = true;
      log_warning("{}: edits objects that {} does not have; these edits are skipped",
                  file_.string(), scene_.string());
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
  if (request.frames.first > last || (request.frames.last && *request.frames.last <= first)) {
    return fail("{}: has no frame in --frames {}:{}; its frames are {} to {}",
                recording.folder.string(), request.frames.first,
                request.frames.last ? std::to_string(*request.frames.last) : "", first, last);
  }
  if (request.frames.last && *request.frames.last > last + 1) {
    log_warning("{}: --frames ends at {}, but the last frame is {}", recording.folder.string(),
                *request.frames.last, last);
  }
  return {};
}

// Returns the index of the first frame whose number is not less than `number`; numbers have gaps.
int index_of(const Recording& recording, int number) {
  const auto found = std::ranges::lower_bound(recording.frames, number, {}, &RecordedFrame::number);
  return static_cast<int>(found - recording.frames.begin());
}

// Returns the image's size, scaled down if the window would be too large for a screen.
GlContext::Size window_size_for(GlContext::Size image) {
  constexpr double kMaxWidth = 1600.0;
  constexpr double kMaxHeight = 960.0;
  const double scale = std::min({1.0, kMaxWidth / image.width, kMaxHeight / image.height});
  return {static_cast<int>(scale * image.width), static_cast<int>(scale * image.height)};
}

// Loads the events of the recorded session. Returns only its lights if the request disables edits.
Result<SceneEvents> load_events(const ReplayRequest& request, const Recording& recording) {
  auto events = load_scene_events(recording.folder / "events.jsonl");
  if (request.edits) return events;
  SceneEvents lights_only;
  if (events) {
    lights_only.lights = std::move(events->lights);
  } else {
    log_warning("{}; the light is measured again", events.error().message);
  }
  return lights_only;
}

Result<std::unique_ptr<FrameSource>> open_frames(const ReplayRequest& request,
                                                 const Recording& recording) {
  RecordingSourceOptions options;
  options.first = index_of(recording, request.frames.first);
  if (request.frames.last) options.last = index_of(recording, *request.frames.last);
  if (options.last && *options.last <= options.first) {
    return fail("{}: has no frame in --frames {}:{}", recording.folder.string(),
                request.frames.first, *request.frames.last);
  }
  if (request.threads <= 1) options.look_ahead = 0;
  return open_recording_source(recording, options);
}

struct ReplaySetup {
  Recording recording;
  std::optional<TagsInUse> tags;
  SceneEvents events;
  std::unique_ptr<FrameSource> source;
  std::unique_ptr<ResidualWatch> residual_watch;   // set if frames are tracked
  std::optional<CalibrationRecord> camera_record;  // loaded with --refine-camera
  GlContext::Size image;                           // [px]
  std::unique_ptr<GlContext> context;
  std::unique_ptr<ReplayView> view;
  RunOutputs outputs;

  [[nodiscard]] bool has_window() const { return context->window_size().width > 0; }
};

Result<Recording> open_checked_recording(const ReplayRequest& request) {
  OpenRecordingOptions options;
  options.tags = request.tags;
  options.camera = request.camera;
  options.camera_name = request.camera_name;
  options.require_tags = !request.poses_from;  // given poses need no tags
  PENUMBRA_TRY(auto recording, open_recording(request.recording, options));
  for (const std::string& notice : recording.notices) log_warning("{}", notice);
  PENUMBRA_TRY_VOID(check_range(request, recording));
  check_groundtruth(request, recording);
  return recording;
}

Result<std::unique_ptr<ReplayView>> open_view(const ReplayRequest& request, ReplaySetup& setup,
                                              std::shared_ptr<const Scene> scene,
                                              PoseSource poses) {
  SessionOptions options = request;
  options.recorded_light = std::move(setup.events.lights);
  options.scene_start_ns =
      setup.events.scene_start_ns.value_or(setup.recording.frames.front().timestamp_ns);
  PENUMBRA_TRY(auto view, ReplayView::open(request, *setup.context, scene, *setup.recording.camera,
                                           std::move(poses), options));
  return std::make_unique<ReplayView>(std::move(view));
}

// Opens the inputs, the view and the outputs. The quickest checks come first.
Result<ReplaySetup> open_setup(const ReplayRequest& request, InterruptWatch& interrupt) {
  ReplaySetup setup;
  PENUMBRA_TRY(setup.recording, open_checked_recording(request));
  const Recording& recording = setup.recording;
  if (recording.tags) {
    setup.tags =
        tags_in_use(request.tags.value_or(recording.folder / "tags.yaml"), *recording.tags);
  }
  PENUMBRA_TRY(const auto loaded,
               load_run_scene(request, recording.tags ? &*recording.tags : nullptr));
  const auto& scene = loaded.scene;
  PENUMBRA_TRY(auto poses, open_replay_poses(request, recording, *scene));
  if (recording.tags && !request.poses_from) {
    PENUMBRA_TRY(setup.residual_watch, ResidualWatch::create(*recording.camera, *recording.tags));
  }
  if (request.refined_camera) {
    PENUMBRA_TRY(setup.camera_record,
                 load_calibration_record(recording.camera_file, *recording.camera));
  }
  std::vector<PlanOptions> plans;
  for (const ComparedTechnique& pane : request.compare) plans.push_back(pane.plan);
  if (plans.empty()) plans.push_back(request.plan);
  log_scene_warnings(*scene, plans);
  PENUMBRA_TRY(setup.events, load_events(request, recording));
  PENUMBRA_TRY_VOID(load_added_models(setup.events, *scene, recording.folder / "events.jsonl"));
  PENUMBRA_TRY_VOID(check_outputs(request, recording, *scene));
  PENUMBRA_TRY(setup.source, open_frames(request, recording));

  setup.image = image_size(request, *recording.camera);
  PENUMBRA_TRY(setup.context, open_run_context({.window = request.window,
                                                .full_screen = request.viewer.full_screen},
                                               window_size_for(setup.image)));
  if (setup.tags && !request.poses_from) print_tags(*setup.tags);
  log_info("OpenGL: {}, {}", setup.context->info().renderer, setup.context->info().version);
  for (const auto& [name, version] : component_versions()) log_info("{} {}", name, version);
  PENUMBRA_TRY(setup.view, open_view(request, setup, scene, std::move(poses)));

  interrupt.hold();  // from here on, a signal ends the loop and not the process
  const std::vector<std::string> groups =
      recording.tags ? other_groups(*recording.tags) : std::vector<std::string>();
  PENUMBRA_TRY(setup.outputs, open_outputs(request,
                                           {setup.image.width, setup.image.height,
                                            median_frame_interval_s(recording)},
                                           groups, request.threads > 1 ? kEncodeAhead : 0));
  return setup;
}

// Draws, shows and writes the frames. While a frame is drawn, the next ones are tracked and the
// previous one is encoded. Each stage processes the frames in order, so timing does not affect
// results.
class ReplayLoop {
 public:
  ReplayLoop(const ReplayRequest& request, ReplaySetup& setup, InterruptWatch& interrupt)
      : request_(request),
        setup_(setup),
        interrupt_(interrupt),
        run_({*setup.recording.camera, setup.recording.groundtruth.has_value()}),
        late_(setup.view->session(), setup.outputs, run_),
        edits_(setup.recording, setup.events, request.scene),
        image_faults_(setup.recording.tags && !request.poses_from
                          ? std::make_unique<ImageFaultWatch>(*setup.recording.tags)
                          : nullptr),
        refinement_(request.refine_map ? std::make_unique<MapRefinement>(*setup.recording.camera,
                                                                         *setup.recording.tags,
                                                                         RefinementTiming::in_frame)
                                       : nullptr),
        tracked_([this] { return track_next(); }, request.threads > 1 ? kTrackAhead : 0) {}

  [[nodiscard]] Result<void> open_viewer();
  // If an output can't be written, closes it and continues. If a frame can't be read or drawn,
  // fails; the outputs of an earlier run are then not replaced.
  [[nodiscard]] Result<void> run();
  [[nodiscard]] Result<RunReport> finish();

 private:
  struct TrackedItem {
    TrackedFrame tracked;
    StageTime capture_time;
  };
  using TrackAhead = LookAhead<TrackedItem>;

  [[nodiscard]] TrackAhead::Item track_next();
  [[nodiscard]] Result<void> draw(TrackedItem item);
  void write(const SessionFrame& frame);
  [[nodiscard]] RunReport report();

  const ReplayRequest& request_;
  ReplaySetup& setup_;
  InterruptWatch& interrupt_;
  RunRecorder run_;
  RunHost* host_ = nullptr;  // the viewer's host
  std::unique_ptr<Viewer> viewer_;
  LateOutputs late_;
  RecordedEdits edits_;
  Pacer pacer_;
  bool stopped_ = false;
  std::optional<Error> failure_;                   // first error of an output
  std::unique_ptr<ImageFaultWatch> image_faults_;  // set if frames are tracked
  std::unique_ptr<MapRefinement> refinement_;      // set with --refine-map
  TrackAhead tracked_;  // declared last: its thread uses the other members
};

Result<void> ReplayLoop::open_viewer() {
  if (!setup_.has_window()) return {};
  PENUMBRA_TRY(auto overlay, Overlay::create(*setup_.context));
  PENUMBRA_TRY(host_, setup_.view->open_host(*setup_.context, run_, setup_.recording));
  viewer_ = std::make_unique<Viewer>(*setup_.context, *host_, std::move(overlay), request_.viewer);
  return {};
}

ReplayLoop::TrackAhead::Item ReplayLoop::track_next() {
  PENUMBRA_TRY(auto frame, setup_.source->next());
  if (!frame) return std::optional<TrackedItem>();
  TrackedFrame done = setup_.view->track(*frame);
  if (image_faults_) image_faults_->observe(done);
  // Before the map changes: this frame's pose comes from the previous map.
  if (setup_.residual_watch) {
    for (const std::string& notice : setup_.residual_watch->observe(done))
      log_warning("{}", notice);
    setup_.view->set_map_sigma(setup_.residual_watch->map_sigma_m());
  }
  if (refinement_) {
    if (const auto refined = refinement_->observe(done, setup_.residual_watch->latest())) {
      PENUMBRA_TRY_VOID(setup_.view->set_map(refined->camera, refined->map));
      PENUMBRA_TRY_VOID(setup_.residual_watch->restart(refined->camera, refined->map));
    }
  }
  return std::optional<TrackedItem>({std::move(done), setup_.source->capture_time()});
}

Result<void> ReplayLoop::run() {
  ProgressBar progress(setup_.source->frame_count().value_or(0));
  while (!stopped_) {
    auto item = tracked_.next();
    if (item && !*item) break;
    const auto done = item ? draw(std::move(**item)) : tl::unexpected(item.error());
    if (!done) {
      // The previous frame may be pending, because images may be read back one frame late.
      if (const auto rest = late_.write_pending(); !rest) log_warning("{}", rest.error().message);
      return done;
    }
    progress.update(run_.frames());
  }
  if (refinement_) refinement_->stop();  // the next frames may be tracked still
  return {};
}

Result<void> ReplayLoop::draw(TrackedItem item) {
  const Stopwatch watch;
  run_.add_time("capture", item.capture_time);
  const std::uint64_t sequence = item.tracked.frame.sequence;
  const std::int64_t timestamp_ns = item.tracked.frame.timestamp_ns;
  edits_.replay_until(timestamp_ns, *setup_.view);
  PENUMBRA_TRY(const auto done,
               setup_.view->draw(std::move(item.tracked), setup_.outputs.frames != nullptr));
  run_.add_frame(done);
  const PoseEstimate& pose = done.tracked.pose;
  if (is_logged(LogLevel::debug)) {
    const std::string reason = text_of(pose.reason);
    log_debug("frame {}: {}{}{}", sequence, to_string(pose.status), reason.empty() ? "" : ": ",
              reason);
  }
  write(done);
  run_.add_time("frame", watch.elapsed());

  if (request_.realtime || setup_.has_window()) {
    pacer_.wait_for(timestamp_ns, viewer_ ? viewer_->paused_ms() : 0.0);
  }
  if (viewer_) {
    host_->observe(done);
    stopped_ = !viewer_->show(interrupt_) || stopped_;
  }
  stopped_ = interrupt_.interrupted() || stopped_;
  return {};
}

void ReplayLoop::write(const SessionFrame& frame) {
  const auto written = late_.write(frame, setup_.view->pixels());
  if (written) return;
  if (!failure_) failure_ = written.error();
  stopped_ = !setup_.outputs.any() && !setup_.outputs.report && !setup_.has_window();
  if (!stopped_) {
    log_warning("{}; this output is closed, the replay continues", written.error().message);
  }
}

RunReport ReplayLoop::report() {
  setup_.view->take_gpu_times(run_);
  RunReport report = run_.report();
  describe_run(request_, *setup_.context, setup_.view->first_session(), report);
  report.recording = request_.recording.string();
  report.tags = setup_.tags;
  if (image_faults_) report.image_fault = image_faults_->fault();
  if (setup_.residual_watch) report.systematic_error = setup_.residual_watch->found();
  if (refinement_) report.map_refinement = refinement_->report();
  report.width = setup_.image.width;
  report.height = setup_.image.height;
  report.panes = setup_.view->pane_reports();
  if (const std::int64_t damaged = setup_.source->damaged(); damaged > 0) {
    report.camera_faults[std::string(name_of(CaptureFault::damaged))] = damaged;
    // Like `penumbra live`, counts damaged frames as captured and dropped.
    report.frames_damaged = report.frames_dropped = static_cast<int>(damaged);
    report.frames_captured = report.frames + report.frames_damaged;
  }
  report.interrupted = interrupt_.interrupted();
  report.log_lines_dropped = dropped_log_lines();
  add_accuracy(request_, setup_.recording, run_, report);
  return report;
}

Result<RunReport> ReplayLoop::finish() {
  if (!failure_) failure_ = display_loss(*setup_.context);
  if (run_.frames() == 0) {
    return fail("{}: no frame was replayed", setup_.recording.folder.string());
  }
  if (auto rest = late_.write_pending(); !rest && !failure_) failure_ = rest.error();
  if (auto finished = setup_.outputs.finish(run_); !finished && !failure_) {
    failure_ = finished.error();
  }
  if (refinement_) {
    const auto written = write_refined(*refinement_, setup_.outputs, setup_.camera_record);
    if (!written && !failure_) failure_ = written.error();
  }
  RunReport report = this->report();
  if (const auto written = setup_.outputs.write_scene(setup_.view->first_session());
      !written && !failure_) {
    failure_ = written.error();
  }
  report.failure = std::move(failure_);
  if (auto written = setup_.outputs.write_report(report); !written && !report.failure) {
    report.failure = written.error();
  }
  return report;
}

}  // namespace

Result<RunReport> run_replay(const ReplayRequest& request) {
  InterruptWatch interrupt;  // declared first, because decoders and OpenGL start threads
  PENUMBRA_TRY(auto setup, open_setup(request, interrupt));
  ReplayLoop loop(request, setup, interrupt);
  PENUMBRA_TRY_VOID(loop.open_viewer());
  PENUMBRA_TRY_VOID(loop.run());
  return loop.finish();
}

}  // namespace penumbra
