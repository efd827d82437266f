#include "app/live/live_run.hpp"

#include <algorithm>
#include <chrono>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "app/interrupt.hpp"
#include "app/live/camera_wait.hpp"
#include "app/live/live_host.hpp"
#include "app/live/live_pipeline.hpp"
#include "app/live/live_recorder.hpp"
#include "app/logging.hpp"
#include "app/output/run_outputs.hpp"
#include "app/recording/recording_writer.hpp"
#include "app/run/refined_files.hpp"
#include "app/run/run_scene.hpp"
#include "app/run_inputs.hpp"
#include "app/session/image_fault_watch.hpp"
#include "app/session/map_refinement.hpp"
#include "app/session/session.hpp"
#include "app/standard_streams.hpp"
#include "app/window/overlay.hpp"
#include "app/window/stall_display.hpp"
#include "app/window/viewer.hpp"
#include "calib/refinement/residual_watch.hpp"
#include "core/camera/camera_file.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kPatience(50);  // interval of polling the window and Ctrl-C
constexpr int kFramesToEncode = 4;     // queued for the encoder
constexpr std::size_t kMaxYamlBytes = 16'000'000;

// Fails if an output lies in the recording's folder, or the recording in the folder of images.
Result<void> check_apart_from_record(const LiveRequest& request) {
  if (!request.record) return {};
  for (const auto& output : {request.output, request.poses, request.report, request.group_poses,
                             request.refined_map, request.refined_camera, request.saved_scene}) {
    if (output && !is_stream(*output) && lies_in(*output, *request.record)) {
      return fail("{}: lies in {}, where the recording is made (--record); name another place",
                  output->string(), request.record->string());
    }
  }
  if (request.output && output_kind(*request.output) == OutputKind::folder &&
      lies_in(*request.record, *request.output)) {
    return fail("{}: lies in {}, which holds images and nothing else; name another place",
                request.record->string(), request.output->string());
  }
  return {};
}

// Fails if an output would replace an input of this run or another output.
Result<void> check_outputs(const LiveRequest& request, const CameraAddress& address,
                           const Scene& scene) {
  std::vector<std::filesystem::path> taken = {request.scene, request.tags};
  if (!request.camera.fov_deg) taken.push_back(request.camera.calibration);
  if (request.kernel_file) taken.push_back(*request.kernel_file);
  if (request.configuration) taken.push_back(*request.configuration);
  for (std::filesystem::path& file : model_files(scene)) taken.push_back(std::move(file));
  if (request.record) taken.push_back(*request.record);
  if (address.kind == CameraAddress::Kind::recording) {
    PENUMBRA_TRY(const auto played, open_as_camera(address));
    for (const std::string& notice : played.notices) log_warning("{}", notice);
    PENUMBRA_TRY_VOID(check_apart_from(played, request, request.record));
    for (std::filesystem::path& file : files_of(played)) taken.push_back(std::move(file));
  }
  PENUMBRA_TRY_VOID(check_output_paths(request, std::move(taken)));
  return check_apart_from_record(request);
}

// Returns the data that starts each recording of this session.
Result<RecordingHead> recording_head(const LiveRequest& request, const LiveSource& source,
                                     const CameraModel& camera, const Scene& scene) {
  // Copies the calibration file verbatim, unless it is scaled or contains other cameras.
  const bool adapt = request.camera.scale_calibration || !request.camera.camera_name.empty() ||
                     request.camera.fov_deg;
  PENUMBRA_TRY(auto camera_yaml, adapt ? Result<std::string>(ros_camera_text(camera))
                                       : read_text_file(request.camera.calibration, kMaxYamlBytes));
  PENUMBRA_TRY(auto tags_yaml, read_text_file(request.tags, kMaxYamlBytes));
  RecordingHead head;
  head.camera = source.description();
  head.format = source.format();
  head.controls = source.controls();
  head.read_controls = [&source] { return source.controls(); };
  head.camera_yaml = std::move(camera_yaml);
  head.tags_yaml = std::move(tags_yaml);
  PENUMBRA_TRY(head.session,
               session_head(request.scene, scene, request.kernel_file, request.kept_options));
  return head;
}

struct LiveSetup {
  CameraModel camera;
  TagMap tags;
  TagsInUse used_tags;
  std::unique_ptr<ResidualWatch> residual_watch;
  std::optional<CalibrationRecord> camera_record;  // loaded with --refine-camera
  std::unique_ptr<GlContext> context;
  std::unique_ptr<Overlay> overlay;  // only with a window
  std::unique_ptr<Session> session;
  std::unique_ptr<LiveSource> source;
  RunOutputs outputs;
  std::unique_ptr<LiveRecorder> recorder;
};

Result<GroupTracker> create_tracker(const LiveRequest& request, const CameraModel& camera,
                                    const TagMap& tags, const Scene& scene) {
  TrackerOptions tracking = request.tracking;
  if (tracking.search_timing != SearchTiming::in_frame) {
    tracking.search_timing = SearchTiming::when_done;
  }
  auto tracker = GroupTracker::create(
      camera, tags, tracking, wanted_groups(scene, tags, request.tags, request, request.plan.skip));
  if (!tracker) return fail_in(request.tags.string(), tracker.error());
  return tracker;
}

struct CameraInUse {
  CameraModel model;
  std::optional<CalibrationRecord> record;  // loaded with --refine-camera
};

Result<CameraInUse> find_camera(const LiveRequest& request, const CameraAddress& address) {
  if (request.camera.fov_deg) {
    // Opens the camera for a moment, to learn the size of its images.
    PENUMBRA_TRY_VOID(check_camera(address));
    PENUMBRA_TRY(const auto source, open_camera(address, request.camera, nullptr));
    const StreamFormat format = source->format();
    PENUMBRA_TRY(auto guessed,
                 guessed_camera(*request.camera.fov_deg, format.width, format.height));
    return CameraInUse{std::move(guessed), std::nullopt};
  }
  PENUMBRA_TRY(const auto calibrated,
               load_chosen_camera(request.camera.calibration, request.camera.camera_name));
  PENUMBRA_TRY(auto camera, calibration_at_size(request.camera, address, calibrated));
  std::optional<CalibrationRecord> record;
  // The record holds for the size of the file.
  if (request.refined_camera && camera.width() == calibrated.width() &&
      camera.height() == calibrated.height()) {
    PENUMBRA_TRY(record, load_calibration_record(request.camera.calibration, camera));
  } else if (request.refined_camera) {
    log_warning(
        "--refine-camera: the camera runs at another size than {}, so the uncertainty in that file "
        "is not used",
        request.camera.calibration.string());
  }
  return CameraInUse{std::move(camera), std::move(record)};
}

struct LiveWindow {
  std::unique_ptr<GlContext> context;
  std::unique_ptr<Overlay> overlay;  // nullptr if the context is offscreen
};

// `size`: of the window, unless it is full-screen [px].
Result<LiveWindow> open_live_window(const LiveRequest& request, GlContext::Size size) {
  const ViewerOptions& viewer = request.viewer;
  LiveWindow window;
  PENUMBRA_TRY(window.context, open_run_context({.window = request.window,
                                                 .vsync = request.vsync,
                                                 .full_screen = viewer.full_screen || viewer.kiosk,
                                                 .required = viewer.kiosk},
                                                size));
  if (window.context->window_size().width > 0) {
    PENUMBRA_TRY(window.overlay, Overlay::create(*window.context));
  }
  return window;
}

// Opens the inputs, the session and the outputs. The quickest checks come first.
Result<LiveSetup> open_setup(const LiveRequest& request, InterruptWatch& interrupt) {
  PENUMBRA_TRY(const auto address, parse_camera(request.camera.source));
  LiveWindow window;
  std::optional<CameraWait> wait;
  if (request.viewer.kiosk) {
    PENUMBRA_TRY(window, open_live_window(request, {640, 480}));
    wait.emplace(*window.context, *window.overlay);
  }
  const auto when_there = [&wait](const auto& open) {
    return wait ? wait->until_open(open) : open();
  };
  const auto find = [&] { return find_camera(request, address); };
  // A calibration is found without the camera.
  PENUMBRA_TRY(auto in_use, request.camera.fov_deg ? when_there(find) : find());
  CameraModel& camera = in_use.model;
  PENUMBRA_TRY(auto tags, load_tag_map(request.tags));
  PENUMBRA_TRY(const auto loaded, load_run_scene(request, &tags));
  const auto& scene = loaded.scene;
  PENUMBRA_TRY(auto tracker, create_tracker(request, camera, tags, *scene));
  log_scene_warnings(*scene, request.plan);
  PENUMBRA_TRY(auto residual_watch, ResidualWatch::create(camera, tags));

  PENUMBRA_TRY_VOID(when_there([&] { return check_camera(address); }));
  if (!window.context) {
    PENUMBRA_TRY(window, open_live_window(request, {camera.width(), camera.height()}));
  }
  TagsInUse used_tags = tags_in_use(request.tags, tags);
  print_tags(used_tags);
  PENUMBRA_TRY(auto session,
               Session::create(*window.context, scene, camera, std::move(tracker), request));
  for (const ObjectAdded& added : loaded.added) session.record_added(added);
  // Compiles the shaders before the camera starts, to draw its first images without delay.
  PENUMBRA_TRY_VOID(session.warm_up(PixelFormat::yuv420p));

  const auto open = [&]() -> Result<std::unique_ptr<LiveSource>> {
    return open_camera(address, request.camera, &camera);
  };
  PENUMBRA_TRY(auto source, when_there(open));
  PENUMBRA_TRY_VOID(check_size_or_offer_scaling(request.camera, address, source->format(), camera));
  log_info("{}", source->description());
  PENUMBRA_TRY_VOID(check_outputs(request, address, *scene));
  interrupt.hold();
  PENUMBRA_TRY(auto outputs,
               open_outputs(request, {camera.width(), camera.height(), source->format().interval_s},
                            other_groups(tags), kFramesToEncode));
  PENUMBRA_TRY(auto head, recording_head(request, *source, camera, *scene));
  auto recorder = std::make_unique<LiveRecorder>(std::move(head));
  if (request.record) PENUMBRA_TRY_VOID(recorder->start(*request.record));
  return LiveSetup{std::move(camera),         std::move(tags),
                   std::move(used_tags),      std::move(residual_watch),
                   std::move(in_use.record),  std::move(window.context),
                   std::move(window.overlay), std::make_unique<Session>(std::move(session)),
                   std::move(source),         std::move(outputs),
                   std::move(recorder)};
}

// Draws, shows and writes frames until the session ends.
class LiveLoop {
 public:
  LiveLoop(const LiveRequest& request, LiveSetup& setup, InterruptWatch& interrupt)
      : request_(request),
        setup_(setup),
        interrupt_(interrupt),
        run_({setup.camera}),
        host_(*setup.session, run_, *setup.source, *setup.recorder, request),
        viewer_(setup.overlay ? std::make_unique<Viewer>(*setup.context, host_,
                                                         std::move(setup.overlay), request.viewer)
                              : nullptr),
        late_(setup.session.get(), setup.outputs, run_),
        image_faults_(setup.tags),
        refinement_(request.refine_map ? std::make_unique<MapRefinement>(
                                             setup.camera, setup.tags, RefinementTiming::when_done)
                                       : nullptr),
        pipeline_(
            *setup.source, [this](const Frame& frame) { return track(frame); },
            [this](const CapturedImage& image) {
              if (const auto writer = setup_.recorder->writer()) writer->add_image(image);
            },
            request.threads > 1) {
    host_.set_sheet(sheet_area(&setup.tags));
  }

  void run();
  [[nodiscard]] Result<RunReport> finish();

 private:
  [[nodiscard]] TrackedFrame track(const Frame& frame) {
    TrackedFrame tracked = setup_.session->track(frame);
    image_faults_.observe(tracked);
    // Before the map changes: this frame's pose comes from the previous map.
    for (const std::string& notice : setup_.residual_watch->observe(tracked)) {
      // The residuals of a guessed lens are no evidence about the map.
      if (!request_.camera.fov_deg) log_warning("{}", notice);
    }
    setup_.session->set_map_sigma(setup_.residual_watch->map_sigma_m());
    refine_map(tracked);
    return tracked;
  }
  void refine_map(const TrackedFrame& tracked);
  void record_faults();
  void draw(ReadyFrame ready);
  void draw_stall();
  void show(Viewer::ShownFrame which);
  // Logs and remembers the error of an output that was closed; the session continues.
  void note_failure(const Result<void>& written);
  void fail_with(const Error& error) {
    failure_ = error;
    stopped_ = true;
  }
  [[nodiscard]] RunReport report();

  const LiveRequest& request_;
  LiveSetup& setup_;
  InterruptWatch& interrupt_;
  RunRecorder run_;
  LiveHost host_;
  std::unique_ptr<Viewer> viewer_;
  std::vector<std::uint8_t> pixels_;  // empty if no composited frames are written
  LateOutputs late_;
  StallDisplay stall_display_;
  bool stopped_ = false;
  std::optional<Error> failure_;
  // Images up to this time were delayed by a pause, so their age does not count as latency.
  std::int64_t paused_until_ns_ = std::numeric_limits<std::int64_t>::min();
  ImageFaultWatch image_faults_;
  std::unique_ptr<MapRefinement> refinement_;  // set with --refine-map
  LivePipeline pipeline_;  // declared last, because its threads use the other members
};

void LiveLoop::run() {
  if (setup_.outputs.frames) {
    pixels_.resize(static_cast<std::size_t>(setup_.camera.width()) *
                   static_cast<std::size_t>(setup_.camera.height()) * 4U);
  }
  while (!stopped_ && !pipeline_.finished()) {
    auto ready = pipeline_.take(kPatience);
    record_faults();
    if (ready) {
      draw(std::move(*ready));
    } else {
      draw_stall();
    }
    if (host_.is_over() || interrupt_.interrupted()) stopped_ = true;
  }
  pipeline_.stop();
  if (refinement_) refinement_->stop();
}

void LiveLoop::refine_map(const TrackedFrame& tracked) {
  if (!refinement_) return;
  const auto refined = refinement_->observe(tracked, setup_.residual_watch->latest());
  if (!refined) return;
  auto set = setup_.session->set_map(refined->camera, refined->map);
  if (set) set = setup_.residual_watch->restart(refined->camera, refined->map);
  if (!set) log_warning("the refined tag map is not used: {}", set.error().message);
}

void LiveLoop::record_faults() {
  for (const auto& event : setup_.source->faults().take_events()) {
    if (const auto writer = setup_.recorder->writer()) {
      writer->add_event(event.timestamp_ns, name_of(event.fault), event.detail);
    }
  }
}

void LiveLoop::draw(ReadyFrame ready) {
  host_.set_live();
  if (run_.frames() == 0) {
    if (const auto warning = focus_warning(request_.camera.calibration, setup_.source->focus())) {
      log_warning("{}", *warning);
    }
  }
  const Stopwatch watch;
  const std::int64_t timestamp_ns = ready.tracked.frame.timestamp_ns;
  run_.add_time("capture", ready.capture_time);
  stall_display_.observe(ready.tracked);
  const auto done = setup_.session->draw(std::move(ready.tracked), pixels_, ReadBackTime::later);
  if (!done) return fail_with(done.error());
  run_.add_frame(*done);
  setup_.recorder->add(*done, *setup_.session);
  if (viewer_) host_.observe(*done);
  show(Viewer::ShownFrame::next);
  // Latency from the driver's timestamp until the image is on the screen (offscreen: drawn).
  const bool paused = timestamp_ns <= paused_until_ns_;
  if (!paused) {
    // The age can be negative: some drivers use the time at which the exposure will end.
    const std::int64_t age_ns = std::max<std::int64_t>(monotonic_ns() - timestamp_ns, 0);
    run_.add_time("latency", {static_cast<double>(age_ns) * 1e-6, 0.0});
  }
  note_failure(late_.write(*done, pixels_));
  if (!paused) run_.add_time("frame", watch.elapsed());
}

void LiveLoop::draw_stall() {
  note_failure(late_.write_pending());
  const auto stall_ns = pipeline_.stale_for_ns();
  if (stall_ns) host_.set_stalled(*stall_ns);
  if (auto repeated = stall_ns ? stall_display_.frame_to_show(*stall_ns) : std::nullopt) {
    const auto drawn = setup_.session->redraw(std::move(*repeated));
    if (!drawn) return fail_with(drawn.error());
    if (viewer_) host_.observe(*drawn);
    if (!stall_display_.holds()) host_.forget_frame();
  }
  show(Viewer::ShownFrame::same);
}

void LiveLoop::show(Viewer::ShownFrame which) {
  if (!viewer_) return;
  const double paused_ms = viewer_->paused_ms();
  if (!viewer_->show(interrupt_, which)) stopped_ = true;
  if (viewer_->paused_ms() > paused_ms) paused_until_ns_ = monotonic_ns();
}

void LiveLoop::note_failure(const Result<void>& written) {
  if (written) return;
  log_warning("{}; this output is closed, the session continues", written.error().message);
  if (!failure_) failure_ = written.error();
  if (!setup_.outputs.frames) pixels_.clear();
}

RunReport LiveLoop::report() {
  run_.add_gpu_times(setup_.session->take_gpu_times());
  const CaptureStats stats = setup_.source->faults().stats();
  RunReport report = run_.report();
  describe_run(request_, *setup_.context, *setup_.session, report);
  report.recording = request_.camera.source;
  report.tags = setup_.used_tags;
  report.image_fault = image_faults_.fault();
  report.calibrated = !request_.camera.fov_deg;
  if (report.calibrated) report.systematic_error = setup_.residual_watch->found();
  if (refinement_) report.map_refinement = refinement_->report();
  report.width = setup_.camera.width();
  report.height = setup_.camera.height();
  report.frames_captured = static_cast<int>(stats.frames);
  report.frames_dropped = report.frames_captured - report.frames;
  report.frames_damaged = static_cast<int>(stats.undecoded);
  report.interrupted = interrupt_.interrupted();
  report.calibrates = host_.calibrates();
  report.log_lines_dropped = dropped_log_lines();
  const auto faults = fault_counts(stats);
  report.camera_faults.insert(faults.begin(), faults.end());
  return report;
}

Result<RunReport> LiveLoop::finish() {
  if (!failure_) failure_ = display_loss(*setup_.context);
  if (!failure_) failure_ = pipeline_.error();
  if (const auto rest = late_.write_pending(); !rest && !failure_) failure_ = rest.error();
  // Without a frame no output is expected, so an output's failure is not reported.
  if (const auto finished = setup_.outputs.finish(run_);
      !finished && !failure_ && run_.frames() > 0) {
    failure_ = finished.error();
  }
  RunReport report = this->report();
  const auto recorded = setup_.recorder->finish();
  if (const RecordedFrames frames = setup_.recorder->frames();
      frames.written + frames.left_out > 0) {
    report.recorded = frames;
  }
  // Printed after the report is written, because a terminal can stall.
  const auto print_recordings = [this] {
    for (const std::string& summary : setup_.recorder->summaries()) fmt::print("{}\n", summary);
  };
  if (report.frames == 0) {
    print_recordings();
    if (failure_) return tl::unexpected(*failure_);
    return fail("{}{}", host_.no_frame_text(),
                recorded ? std::string() : "; and " + recorded.error().message);
  }
  if (!recorded && !failure_) failure_ = recorded.error();
  if (refinement_) {
    const auto written = write_refined(*refinement_, setup_.outputs, setup_.camera_record);
    if (!written && !failure_) failure_ = written.error();
    report.map_refinement = refinement_->report();
  }
  if (const auto written = setup_.outputs.write_scene(*setup_.session); !written && !failure_) {
    failure_ = written.error();
  }
  report.failure = std::move(failure_);
  if (auto written = setup_.outputs.write_report(report); !written && !report.failure) {
    report.failure = written.error();
  }
  print_recordings();
  return report;
}

}  // namespace

Result<RunReport> run_live(const LiveRequest& request) {
  InterruptWatch interrupt;  // declared first, because the objects below start threads
  PENUMBRA_TRY(auto setup, open_setup(request, interrupt));
  LiveLoop loop(request, setup, interrupt);
  loop.run();
  return loop.finish();
}

}  // namespace penumbra
