#include "app/live_run.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <exception>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "app/capture/libcamera_source.hpp"
#include "app/capture/mailbox.hpp"
#include "app/capture/recording_feed.hpp"
#include "app/capture/recording_writer.hpp"
#include "app/capture/v4l2_device.hpp"
#include "app/capture/v4l2_source.hpp"
#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/overlay.hpp"
#include "app/scene_edit.hpp"
#include "app/session.hpp"
#include "app/session_host.hpp"
#include "app/viewer.hpp"
#include "core/camera_file.hpp"
#include "core/text.hpp"
#include "core/units.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

using Clock = std::chrono::steady_clock;  // CLOCK_MONOTONIC, which drivers stamp frames with
using std::chrono::milliseconds;

constexpr milliseconds kPatience(50);              // between looks at the window and at Ctrl-C
constexpr std::int64_t kSilence_ns = 250'000'000;  // without a frame: the picture is not live
constexpr double kHold_s = 0.5;                    // then the pose fades out over this
constexpr int kEncodeAhead = 4;                    // composited frames that wait for the encoder
constexpr std::size_t kMaxYamlBytes = 16'000'000;

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch())
      .count();
}

struct CameraName {
  enum class Kind { v4l2, libcamera, recording } kind = Kind::v4l2;
  std::string name;
};

Result<CameraName> parse_camera(const std::string& camera) {
  if (camera.starts_with('/')) return CameraName{CameraName::Kind::v4l2, camera};
  const std::size_t colon = camera.find(':');
  const std::string kind = camera.substr(0, colon);
  const std::string name = colon == std::string::npos ? std::string() : camera.substr(colon + 1);
  if (kind == "v4l2" && !name.empty()) return CameraName{CameraName::Kind::v4l2, name};
  if (kind == "recording" && !name.empty()) return CameraName{CameraName::Kind::recording, name};
  if (kind == "libcamera" && !name.empty()) return CameraName{CameraName::Kind::libcamera, name};
  return fail(
      "--camera {}: is no camera; give v4l2:/dev/video0 or libcamera:0 (penumbra devices lists "
      "them)",
      camera);
}

// What is wrong with the camera at first sight: before anything else is set up.
Result<void> check_camera(const CameraName& camera) {
  if (camera.kind != CameraName::Kind::v4l2) return {};
  const auto device = V4l2Device::open(camera.name);
  if (!device) return tl::unexpected(device.error());
  return {};
}

Result<std::unique_ptr<LiveSource>> open_camera(const CameraName& name, const LiveRequest& request,
                                                const CameraModel& camera) {
  if (name.kind == CameraName::Kind::recording) {
    OpenRecordingOptions options;
    options.require_camera = options.require_tags = false;
    const auto recording = open_recording(name.name, options);
    if (!recording) return tl::unexpected(recording.error());
    return open_recording_feed(*recording, request.fps);
  }
  CameraWish wish;
  wish.width = request.width.value_or(camera.width());
  wish.height = request.height.value_or(camera.height());
  wish.fps = request.fps.value_or(wish.fps);
  wish.format = request.format;
  wish.recording = request.record.has_value();
  wish.controls = request.controls;
  if (name.kind == CameraName::Kind::libcamera) return open_libcamera_source({wish, name.name});
  return open_v4l2_source({wish, name.name});
}

Result<void> check_size(const LiveRequest& request, const StreamFormat& format,
                        const CameraModel& camera) {
  if (format.width == camera.width() && format.height == camera.height()) return {};
  return fail(
      "{}: is a calibration of {}x{} px, but the camera gives {}x{} px; ask for the calibrated "
      "size (--size {}x{}), or calibrate at this one (penumbra calibrate)",
      request.calibration.string(), camera.width(), camera.height(), format.width, format.height,
      camera.width(), camera.height());
}

Result<std::unique_ptr<RecordingWriter>> open_recording_writer(const LiveRequest& request,
                                                               const LiveSource& source,
                                                               const std::filesystem::path& to) {
  auto camera_yaml = read_text_file(request.calibration, kMaxYamlBytes);
  if (!camera_yaml) return tl::unexpected(camera_yaml.error());
  auto tags_yaml = read_text_file(request.tags, kMaxYamlBytes);
  if (!tags_yaml) return tl::unexpected(tags_yaml.error());
  return RecordingWriter::create(to, {source.description(), source.format(), source.controls(),
                                      std::move(*camera_yaml), std::move(*tags_yaml)});
}

// The recording that is being written, if any: begun and ended while the camera runs.
class Recorder {
 public:
  Recorder(const LiveRequest& request, const LiveSource& source)
      : request_(request), source_(source) {}
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;
  ~Recorder() = default;

  [[nodiscard]] Result<void> start(const std::filesystem::path& folder) {
    auto opened = open_recording_writer(request_, source_, folder);
    if (!opened) return tl::unexpected(opened.error());
    std::shared_ptr<RecordingWriter> writer = std::move(*opened);
    writer->add_event(now_ns(), "start", source_.description());
    scene_told_ = false;
    const std::lock_guard lock(mutex_);
    writer_ = std::move(writer);
    return {};
  }

  // What was given so far is written by a thread of its own: the picture goes on.
  void stop() {
    std::shared_ptr<RecordingWriter> writer;
    {
      const std::lock_guard lock(mutex_);
      writer = std::exchange(writer_, nullptr);
    }
    if (!writer) return;
    writer->add_event(now_ns(), "end");
    ended_.push_back(std::async(std::launch::async, [writer = std::move(writer)] {
      Result<void> finished = writer->finish();
      const RecordingCounts counts = writer->counts();
      fmt::print("recorded {} frames to {}{}\n", counts.written, writer->folder().string(),
                 counts.dropped > 0
                     ? fmt::format("; {} left out, the disk was too slow", counts.dropped)
                     : std::string());
      return finished;
    }));
  }

  // Ends the last one too, and says what became of each; fails where one is not whole.
  [[nodiscard]] Result<void> finish() {
    stop();
    Result<void> all;
    for (std::future<Result<void>>& ended : ended_) {
      if (Result<void> one = ended.get(); !one && all) all = std::move(one);
    }
    ended_.clear();
    return all;
  }

  // By any thread.
  [[nodiscard]] std::shared_ptr<RecordingWriter> writer() const {
    const std::lock_guard lock(mutex_);
    return writer_;
  }

  // What belongs to a frame that was drawn; at first also how the scene came to be as it is.
  void add(const SessionFrame& frame, const Session& session) {
    const auto to = writer();
    if (!to) return;
    const std::int64_t timestamp_ns = frame.tracked.frame.timestamp_ns;
    if (!scene_told_) {
      scene_told_ = true;
      to->add_event(session.scene_start_ns().value_or(timestamp_ns), kSceneStartEvent);
      for (const SceneEdit& edit : session.edits_so_far()) {
        to->add_scene_edit({timestamp_ns, edit});
      }
    } else {
      for (const SceneEdit& edit : frame.edits) to->add_scene_edit({timestamp_ns, edit});
    }
    to->add_pose(timestamp_ns, frame.tracked.pose);
  }

 private:
  const LiveRequest& request_;
  const LiveSource& source_;
  mutable std::mutex mutex_;
  std::shared_ptr<RecordingWriter> writer_;  // guarded by mutex_
  std::vector<std::future<Result<void>>> ended_;
  bool scene_told_ = false;
};

// A frame with its pose, on its way to be drawn.
struct ReadyFrame {
  TrackedFrame tracked;
  StageTime capture_time;  // to decode it
};

// The camera's thread and the tracker's. The newest picture waits for the tracker, older ones are
// dropped; a tracked frame is always drawn.
class Pipeline {
 public:
  Pipeline(LiveSource& source, Session& session, const Recorder& recorder)
      : source_(source), session_(session), recorder_(recorder), last_capture_ns_(now_ns()) {
    capture_ = std::thread([this] { guarded([this] { capture(); }); });
    tracking_ = std::thread([this] { guarded([this] { track(); }); });
  }
  Pipeline(const Pipeline&) = delete;
  Pipeline& operator=(const Pipeline&) = delete;
  ~Pipeline() { stop(); }

  [[nodiscard]] std::optional<ReadyFrame> take() { return ready_.take(kPatience); }
  // Nothing will come any more.
  [[nodiscard]] bool finished() const { return ready_.finished(); }
  // How long the camera has given nothing.
  [[nodiscard]] std::int64_t silence_ns() const { return now_ns() - last_capture_ns_; }
  void stop() {
    source_.stop();
    inbox_.close();
    ready_.close();
    if (capture_.joinable()) capture_.join();
    if (tracking_.joinable()) tracking_.join();
  }
  // Why it ended by itself, if not well.
  [[nodiscard]] std::optional<Error> error() const {
    const std::lock_guard lock(mutex_);
    return error_;
  }

 private:
  void guarded(const std::function<void()>& work) {
    try {
      work();
    } catch (const std::exception& error) {
      set_error({error.what()});
    }
    // Whoever ends, the others have nothing left to do.
    source_.stop();
    inbox_.close();
  }
  void set_error(Error error) {
    const std::lock_guard lock(mutex_);
    if (!error_) error_ = std::move(error);
  }

  void capture() {
    while (true) {
      auto image = source_.next_image();
      if (!image) {
        set_error(image.error());
        return;
      }
      if (!*image) return;
      last_capture_ns_ = now_ns();
      if (const auto writer = recorder_.writer()) writer->add_image(**image);
      inbox_.put(std::move(**image));
    }
  }

  void track() {
    while (!inbox_.finished()) {
      auto image = inbox_.take(kPatience);
      if (!image) continue;
      const Stopwatch watch;
      const std::optional<Frame> frame = source_.decode(*image);
      if (!frame) continue;
      image.reset();  // a JPEG's buffer goes back to the camera
      const StageTime time = watch.elapsed();
      if (!ready_.hand_over({session_.track(*frame), time})) break;
    }
    ready_.close();
  }

  LiveSource& source_;
  Session& session_;
  const Recorder& recorder_;
  std::atomic<std::int64_t> last_capture_ns_;
  Mailbox<CapturedImage> inbox_;
  Mailbox<ReadyFrame> ready_;
  mutable std::mutex mutex_;
  std::optional<Error> error_;  // guarded by mutex_
  std::thread capture_, tracking_;
};

// What is on the screen while the camera gives nothing: the last picture, its pose held and fading,
// then no pose. Never a still picture that looks live.
class Silence {
 public:
  void saw(const TrackedFrame& tracked) { last_ = tracked; }
  // What to draw now; nothing when that is on the screen already.
  [[nodiscard]] std::optional<TrackedFrame> picture(std::int64_t silence_ns) {
    if (!last_ || silence_ns < kSilence_ns) return std::nullopt;
    TrackedFrame tracked = *last_;
    const double age_s = last_->pose.age_s + seconds(silence_ns);
    const bool gone = !tracked.pose.has_pose() || age_s > kHold_s;
    tracked.pose.status = gone ? TrackStatus::lost : TrackStatus::held;
    tracked.pose.age_s = age_s;
    for (GroupEstimate& group : tracked.groups) {
      if (group.has_pose()) group.status = tracked.pose.status;
      group.age_s = age_s;
    }
    // Drawn for the last time; its buffer goes back: a driver that lost its camera waits for every
    // one of them before it takes the camera again.
    if (gone) last_.reset();
    tracked.pose.reason = "no frame from the camera";
    return tracked;
  }

 private:
  std::optional<TrackedFrame> last_;
};

// The session in the window, with its camera.
class LiveHost final : public SessionHost {
 public:
  LiveHost(Session& session, RunRecorder& run, LiveSource& source, Recorder& recorder,
           const LiveRequest& request)
      : SessionHost(session, run),
        run_(run),
        source_(source),
        recorder_(recorder),
        request_(request) {}

  [[nodiscard]] std::string toggle_recording() override {
    if (const auto writer = recorder_.writer()) {
      const std::string folder = writer->folder().string();
      recorder_.stop();
      return "recording ended: " + folder;
    }
    const std::filesystem::path folder =
        request_.record ? free_name(*request_.record, "") : free_name("");
    if (auto started = recorder_.start(folder); !started) return started.error().message;
    return "recording to " + folder.string();
  }

  void describe(HudState& state, bool debug) const override {
    SessionHost::describe(state, debug);
    state.live = true;
    state.latency_ms = run_.recent_ms("latency", kLatencyFrames);
    const CaptureStats stats = source_.faults().stats();
    state.frames_dropped = std::max(0, static_cast<int>(stats.frames) - run_.frames());
    state.trouble = stats.trouble;
    for (std::size_t i = 0; i < kCaptureFaultCount; ++i) {
      if (stats.faults[i] == 0) continue;
      state.faults.emplace_back(name_of(static_cast<CaptureFault>(i)),
                                static_cast<std::int64_t>(stats.faults[i]));
    }
    if (stats.restarts > 0) {
      state.faults.emplace_back("restarts", static_cast<std::int64_t>(stats.restarts));
    }
    if (const auto writer = recorder_.writer()) {
      const RecordingCounts counts = writer->counts();
      state.recording =
          HudRecording{writer->folder().string(), counts.written, counts.dropped, counts.error};
    }
  }

 private:
  static constexpr std::size_t kLatencyFrames = 30;
  const RunRecorder& run_;
  LiveSource& source_;
  Recorder& recorder_;
  const LiveRequest& request_;
};

}  // namespace

Result<std::unique_ptr<LiveSource>> open_live_source(const LiveRequest& request,
                                                     const CameraModel& camera) {
  const auto name = parse_camera(request.camera);
  if (!name) return tl::unexpected(name.error());
  if (auto checked = check_camera(*name); !checked) return tl::unexpected(checked.error());
  auto source = open_camera(*name, request, camera);
  if (!source) return tl::unexpected(source.error());
  if (auto checked = check_size(request, (*source)->format(), camera); !checked) {
    return tl::unexpected(checked.error());
  }
  return source;
}

Result<RunReport> run_live(const LiveRequest& request) {
  InterruptWatch interrupt;  // first: everything below starts threads

  const auto camera = load_camera(request.calibration);
  if (!camera) return tl::unexpected(camera.error());
  const auto tags = load_tag_map(request.tags);
  if (!tags) return tl::unexpected(tags.error());
  auto loaded_scene = load_run_scene(request.scene, request.kernel_file);
  if (!loaded_scene) return tl::unexpected(loaded_scene.error());
  const auto scene = std::make_shared<const Scene>(std::move(*loaded_scene));
  auto tracker =
      GroupTracker::create(*camera, *tags, request.tracking,
                           wanted_groups(*scene, *tags, request.tags, request, request.plan.skip));
  if (!tracker) return fail_in(request.tags.string(), tracker.error());
  tell_warnings(*scene, request.plan);

  const auto name = parse_camera(request.camera);
  if (!name) return tl::unexpected(name.error());
  if (auto checked = check_camera(*name); !checked) return tl::unexpected(checked.error());
  auto context =
      open_run_context({request.window, request.vsync}, {camera->width(), camera->height()});
  if (!context) return tl::unexpected(context.error());
  SessionOptions session_options;
  session_options.plan = request.plan;
  auto session = Session::create(**context, scene, *camera, std::move(*tracker), session_options);
  if (!session) return tl::unexpected(session.error());
  // Before the camera starts: what it gives first would be old by the time it is drawn.
  if (auto warm = session->warm_up(PixelFormat::yuv420p); !warm) {
    return tl::unexpected(warm.error());
  }

  auto source = open_camera(*name, request, *camera);
  if (!source) return tl::unexpected(source.error());
  if (auto checked = check_size(request, (*source)->format(), *camera); !checked) {
    return tl::unexpected(checked.error());
  }
  log_info("{}", (*source)->description());

  std::vector<std::filesystem::path> taken = {request.scene, request.calibration, request.tags};
  if (request.kernel_file) taken.push_back(*request.kernel_file);
  if (request.record) taken.push_back(*request.record);
  if (auto checked = check_output_paths(request, std::move(taken)); !checked) {
    return tl::unexpected(checked.error());
  }
  interrupt.hold();
  auto outputs =
      open_outputs(request, {camera->width(), camera->height(), (*source)->format().interval_s},
                   other_groups(*tags), kEncodeAhead);
  if (!outputs) return tl::unexpected(outputs.error());
  Recorder recorder(request, **source);
  if (request.record) {
    if (auto started = recorder.start(*request.record); !started) {
      return tl::unexpected(started.error());
    }
  }

  RunRecorder run;
  LiveHost host(*session, run, **source, recorder, request);
  std::optional<Viewer> viewer;
  if ((*context)->window_size().width > 0) {
    auto overlay = Overlay::create(**context);
    if (!overlay) return tl::unexpected(overlay.error());
    viewer.emplace(**context, host, std::move(*overlay), request.viewer);
  }
  std::vector<std::uint8_t> pixels;
  if (outputs->frames) {
    pixels.resize(static_cast<std::size_t>(camera->width()) *
                  static_cast<std::size_t>(camera->height()) * 4U);
  }

  Silence silence;
  std::optional<Stopwatch> since_first;
  bool stopped = false;
  const auto show = [&] {
    if (viewer && !viewer->show(interrupt)) stopped = true;
  };
  Pipeline pipeline(**source, *session, recorder);
  while (!stopped && !pipeline.finished()) {
    auto ready = pipeline.take();
    for (const auto& event : (*source)->faults().take_events()) {
      if (const auto writer = recorder.writer()) {
        writer->add_event(now_ns(), name_of(event.fault), event.detail);
      }
    }
    if (ready) {
      if (!since_first) since_first.emplace();
      const Stopwatch watch;
      const std::int64_t timestamp_ns = ready->tracked.frame.timestamp_ns;
      run.add_time("capture", ready->capture_time);
      silence.saw(ready->tracked);
      auto done = session->draw(std::move(ready->tracked), pixels);
      if (!done) return tl::unexpected(done.error());
      run.add_frame(*done);
      recorder.add(*done, *session);
      if (viewer) host.saw(*done);
      show();
      // From the driver's stamp to the picture's being on the screen (or, offscreen, drawn).
      run.add_time("latency", {static_cast<double>(now_ns() - timestamp_ns) * 1e-6, 0.0});
      if (auto written = outputs->write(*done, pixels, run); !written) {
        return tl::unexpected(written.error());
      }
      run.add_time("frame", watch.elapsed());
    } else {
      if (auto picture = silence.picture(pipeline.silence_ns())) {
        auto drawn = session->redraw(std::move(*picture));
        if (!drawn) return tl::unexpected(drawn.error());
        if (viewer) host.saw(*drawn);
        if (!drawn->tracked.pose.has_pose()) host.forget_frame();
      }
      show();
    }
    if (request.duration_s && since_first &&
        since_first->elapsed().wall_ms >= *request.duration_s * 1e3) {
      stopped = true;
    }
    if (interrupt.interrupted()) stopped = true;
  }
  pipeline.stop();
  if (const auto error = pipeline.error()) return tl::unexpected(*error);

  const auto finished = outputs->finish(run);
  const CaptureStats stats = (*source)->faults().stats();
  RunReport report = run.report();
  report.recording = request.camera;
  report.scene = request.scene.string();
  report.width = camera->width();
  report.height = camera->height();
  report.frames_captured = static_cast<int>(stats.frames);
  report.frames_dropped = report.frames_captured - report.frames;
  report.interrupted = interrupt.interrupted();
  report.gl_renderer = (*context)->info().renderer;
  report.gl_version = (*context)->info().version;
  for (std::size_t i = 0; i < kCaptureFaultCount; ++i) {
    if (stats.faults[i] == 0) continue;
    report.camera_faults[std::string(name_of(static_cast<CaptureFault>(i)))] =
        static_cast<std::int64_t>(stats.faults[i]);
  }
  if (stats.restarts > 0) {
    report.camera_faults["restarts"] = static_cast<std::int64_t>(stats.restarts);
  }
  const auto recorded = recorder.finish();
  if (report.frames == 0) return fail("{}: gave no frame", request.camera);
  if (!finished) return tl::unexpected(finished.error());
  if (auto written = outputs->write_report(report); !written) {
    return tl::unexpected(written.error());
  }
  if (!recorded) return tl::unexpected(recorded.error());
  return report;
}

}  // namespace penumbra
