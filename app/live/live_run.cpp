#include "app/live/live_run.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "app/capture/libcamera_source.hpp"
#include "app/capture/v4l2/v4l2_device.hpp"
#include "app/capture/v4l2/v4l2_source.hpp"
#include "app/interrupt.hpp"
#include "app/live/live_pipeline.hpp"
#include "app/live/live_recorder.hpp"
#include "app/logging.hpp"
#include "app/output/late_outputs.hpp"
#include "app/recording/recording_feed.hpp"
#include "app/recording/recording_writer.hpp"
#include "app/session/camera_choice.hpp"
#include "app/session/image_fault_watch.hpp"
#include "app/session/scene_edit.hpp"
#include "app/session/session.hpp"
#include "app/session/session_host.hpp"
#include "app/standard_streams.hpp"
#include "app/window/overlay.hpp"
#include "app/window/silence.hpp"
#include "app/window/viewer.hpp"
#include "core/camera/camera_file.hpp"
#include "core/camera/focus_file.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kPatience(50);  // between looks at the window and at Ctrl-C
constexpr int kEncodeAhead = 4;        // composited frames that wait for the encoder
constexpr double kLongestStart_s = 10.0;
constexpr std::size_t kMaxYamlBytes = 16'000'000;

constexpr std::string_view kRecordingKind = "recording:";

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
      "--camera {}: is not a camera; give v4l2:/dev/video0 or libcamera:0 (penumbra devices lists "
      "them), or recording:FOLDER",
      camera);
}

// What is wrong with the camera at first sight: before anything else is set up.
Result<void> check_camera(const CameraName& camera) {
  if (camera.kind != CameraName::Kind::v4l2) return {};
  PENUMBRA_TRY_VOID(V4l2Device::open(camera.name));
  return {};
}

CameraWish wish_for(const CameraModel& camera) {
  CameraWish wish;
  wish.width = camera.width();
  wish.height = camera.height();
  return wish;
}

Result<Recording> open_as_camera(const CameraName& name) {
  OpenRecordingOptions options;
  options.require_camera = options.require_tags = false;
  return open_recording(name.name, options);
}

Result<std::unique_ptr<LiveSource>> open_camera(const CameraName& name, const LiveRequest& request,
                                                const CameraWish& usual) {
  if (name.kind == CameraName::Kind::recording) {
    PENUMBRA_TRY(const auto recording, open_as_camera(name));
    return open_recording_feed(recording, request.fps);
  }
  CameraWish wish = usual;
  wish.width = request.width.value_or(wish.width);
  wish.height = request.height.value_or(wish.height);
  wish.fps = request.fps.value_or(wish.fps);
  wish.format = request.format;
  wish.recording = request.record.has_value();
  wish.controls = request.controls;
  if (name.kind == CameraName::Kind::libcamera) {
    return open_libcamera_source({wish, name.name, request.dma_buf});
  }
  return open_v4l2_source({wish, name.name, request.dma_buf});
}

Result<void> check_size(const LiveRequest& request, const StreamFormat& format,
                        const CameraModel& camera) {
  if (format.width == camera.width() && format.height == camera.height()) return {};
  // The calibrated size was asked for already, unless the request names another; a recording has
  // one alone.
  const bool other_asked = (request.width && *request.width != camera.width()) ||
                           (request.height && *request.height != camera.height());
  return fail(
      "{}: is a calibration of {}x{} px, but the camera gives {}x{} px; {}calibrate at this size "
      "(penumbra calibrate)",
      request.calibration.string(), camera.width(), camera.height(), format.width, format.height,
      other_asked ? fmt::format("ask for the calibrated one (--size {}x{}), or ", camera.width(),
                                camera.height())
                  : std::string());
}

// The same, with an offer to scale the calibration where that is exact.
Result<void> check_size_or_offer(const LiveRequest& request, const CameraName& name,
                                 const StreamFormat& format, const CameraModel& camera) {
  auto checked = check_size(request, format, camera);
  if (checked || request.scale_calibration || !scaled_to(camera, format.width, format.height)) {
    return checked;
  }
  const int larger = std::max(format.width, camera.width());
  const int times = larger / std::min(format.width, camera.width());
  const bool of_recording = name.kind == CameraName::Kind::recording;
  const std::string size =
      of_recording ? std::string() : fmt::format("--size {}x{} ", format.width, format.height);
  return fail(
      "{}; or, if both sizes show the same view, {}x{} pixels of one taken together in the other, "
      "scale the calibration, which is exact then ({}--scale-calibration)",
      checked.error().message, times, times, size);
}

// The calibration at the size that is asked for or that the recording has, if it may be scaled.
Result<CameraModel> calibration_at_size(const LiveRequest& request, const CameraName& name,
                                        const CameraModel& camera) {
  if (!request.scale_calibration) return camera;
  int width = request.width.value_or(camera.width());
  int height = request.height.value_or(camera.height());
  if (name.kind == CameraName::Kind::recording) {
    PENUMBRA_TRY(const auto feed, open_camera(name, request, wish_for(camera)));
    width = feed->format().width;
    height = feed->format().height;
  }
  auto scaled = scaled_to(camera, width, height);
  if (!scaled) return fail_in(request.calibration.string(), scaled.error());
  return scaled;
}

// A recording's folder holds the recording, and a folder of pictures these: neither lies in the
// other.
Result<void> check_apart_from_record(const LiveRequest& request) {
  if (!request.record) return {};
  for (const auto& output : {request.output, request.poses, request.report, request.group_poses}) {
    if (output && !is_stream(*output) && lies_in(*output, *request.record)) {
      return fail("{}: lies in {}, where the recording is made (--record); name another place",
                  output->string(), request.record->string());
    }
  }
  if (request.output && output_kind(*request.output) == OutputKind::folder &&
      lies_in(*request.record, *request.output)) {
    return fail("{}: lies in {}, which holds pictures and nothing else; name another place",
                request.record->string(), request.output->string());
  }
  return {};
}

// What a recording of this session begins with.
Result<RecordingHead> recording_head(const LiveRequest& request, const LiveSource& source,
                                     const CameraModel& camera) {
  // Word for word, with all that calibration says of itself; but not of another size, and not with
  // other cameras.
  const bool other = request.scale_calibration || !request.camera_name.empty();
  PENUMBRA_TRY(auto camera_yaml, other ? Result<std::string>(ros_camera_text(camera))
                                       : read_text_file(request.calibration, kMaxYamlBytes));
  PENUMBRA_TRY(auto tags_yaml, read_text_file(request.tags, kMaxYamlBytes));
  RecordingHead head;
  head.camera = source.description();
  head.format = source.format();
  head.controls = source.controls();
  head.read_controls = [&source] { return source.controls(); };
  head.camera_yaml = std::move(camera_yaml);
  head.tags_yaml = std::move(tags_yaml);
  return head;
}

// Frames that arrived damaged.
std::uint64_t damaged_frames(const CaptureStats& stats) {
  return stats.of(CaptureFault::damaged) + stats.of(CaptureFault::error_frame);
}

// Why a session has no frame, and the remedy.
std::string no_frame_text(const LiveRequest& request, const CaptureStats& stats, bool is_over) {
  const std::string& camera = request.camera;
  const std::uint64_t unusable = damaged_frames(stats) + stats.of(CaptureFault::wrong_format);
  if (unusable > 0) {
    return fmt::format(
        "{}: gave no frame that can be used: {} are damaged or of another size or format; the "
        "warnings above have the remedy",
        camera, unusable);
  }
  if (!is_over) return fmt::format("{}: gave no frame before the session was ended", camera);
  return fmt::format(
      "{}: gave no frame in {:.0f} s; choose another --format or --size, try another USB port, or "
      "see the kernel's log (dmesg)",
      camera, std::max(request.duration_s.value_or(0.0), kLongestStart_s));
}

// The session in the window, with its camera.
class LiveHost final : public SessionHost {
 public:
  LiveHost(Session& session, RunRecorder& run, LiveSource& source, LiveRecorder& recorder,
           const LiveRequest& request)
      : SessionHost(session, run),
        run_(run),
        source_(source),
        recorder_(recorder),
        request_(request) {
    if (request.camera.starts_with(kRecordingKind)) {
      keep_out_of(request.camera.substr(kRecordingKind.size()));
    }
  }

  [[nodiscard]] std::string toggle_recording() override {
    if (const auto writer = recorder_.writer()) {
      const bool failed = writer->counts().error.has_value();
      const std::string folder = writer->folder().string();
      recorder_.stop();
      // One that failed is over already: what is asked for is another.
      if (!failed) return "recording ended: " + folder;
    }
    const std::filesystem::path folder =
        request_.record ? free_name(*request_.record, "") : free_name("");
    if (request_.camera.starts_with(kRecordingKind) &&
        lies_in(folder, request_.camera.substr(kRecordingKind.size()))) {
      return "this folder is the recording that is played; start elsewhere to record";
    }
    recorder_.begin(folder);
    return "recording to " + folder.string();
  }

  // After the duration that was asked for, from the first picture; where none comes at all, after
  // as long, but no sooner than a slow camera starts.
  [[nodiscard]] bool is_over() const override {
    if (!request_.duration_s) return false;
    const double longest_s =
        has_begun_ ? *request_.duration_s : std::max(*request_.duration_s, kLongestStart_s);
    return watch_.elapsed().wall_ms >= longest_s * 1e3;
  }

  // A whole picture came; or none does any more.
  void is_live() {
    if (!std::exchange(has_begun_, true)) watch_.restart();
    silent_s_.reset();
    damaged_ = damaged_frames(source_.faults().stats());
  }
  void is_stale(std::int64_t silence_ns) { silent_s_ = seconds(silence_ns); }

  void describe(HudState& state, bool debug) const override {
    SessionHost::describe(state, debug);
    state.live = true;
    if (state.has_picture) state.silent_s = silent_s_;
    if (!silent_s_) state.latency_ms = run_.recent_ms("latency");
    const CaptureStats stats = source_.faults().stats();
    state.frames_dropped =
        std::max(0, static_cast<int>(stats.frames - stats.undecoded) - run_.frames());
    state.trouble = stats.trouble;
    if (!state.trouble && silent_s_ && damaged_frames(stats) > damaged_) {
      state.trouble = "every frame is damaged";
    }
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
  const RunRecorder& run_;
  LiveSource& source_;
  LiveRecorder& recorder_;
  const LiveRequest& request_;
  Stopwatch watch_;  // since the first picture, or since it was waited for
  bool has_begun_ = false;
  std::optional<double> silent_s_;
  std::uint64_t damaged_ = 0;  // frames, until the last one that was not
};

}  // namespace

Result<std::unique_ptr<LiveSource>> open_live_source(const LiveRequest& request,
                                                     const CameraModel& camera) {
  PENUMBRA_TRY(const auto name, parse_camera(request.camera));
  PENUMBRA_TRY_VOID(check_camera(name));
  auto source = open_camera(name, request, wish_for(camera));
  if (!source) return tl::unexpected(source.error());
  PENUMBRA_TRY_VOID(check_size(request, (*source)->format(), camera));
  return source;
}

Result<std::unique_ptr<LiveSource>> open_live_source(const LiveRequest& request) {
  PENUMBRA_TRY(const auto name, parse_camera(request.camera));
  PENUMBRA_TRY_VOID(check_camera(name));
  return open_camera(name, request, CameraWish());
}

std::optional<std::string> focus_warning(const std::filesystem::path& calibration,
                                         const std::optional<FocusReading>& focus) {
  const auto calibrated = load_focus_position(calibration);
  if (!focus || !calibrated || std::abs(*calibrated - focus->position) <= 0.5 * focus->step) {
    return std::nullopt;
  }
  return fmt::format(
      "{}: was calibrated at focus_position {}, but the camera is focused at {:.4g}; ask for that "
      "focus (--focus {}), or calibrate again",
      calibration.string(), *calibrated, focus->position, *calibrated);
}

bool names_camera(const std::string& source) {
  return source.starts_with("v4l2:") || source.starts_with("libcamera:") ||
         source.starts_with("recording:");
}

Result<RunReport> run_live(const LiveRequest& request) {
  InterruptWatch interrupt;  // first: everything below starts threads

  PENUMBRA_TRY(const auto calibrated, load_chosen_camera(request.calibration, request.camera_name));
  PENUMBRA_TRY(const auto name, parse_camera(request.camera));
  PENUMBRA_TRY(const auto camera, calibration_at_size(request, name, calibrated));
  PENUMBRA_TRY(const auto tags, load_tag_map(request.tags));
  const TagsInUse used_tags = tags_in_use(request.tags, tags);
  PENUMBRA_TRY(auto loaded_scene, load_run_scene(request.scene, request.kernel_file));
  const auto scene = std::make_shared<const Scene>(std::move(loaded_scene));
  TrackerOptions tracking = request.tracking;
  // A camera does not wait.
  if (tracking.search_timing != SearchTiming::in_frame) {
    tracking.search_timing = SearchTiming::when_done;
  }
  auto tracker =
      GroupTracker::create(camera, tags, tracking,
                           wanted_groups(*scene, tags, request.tags, request, request.plan.skip));
  if (!tracker) return fail_in(request.tags.string(), tracker.error());
  tell_warnings(*scene, request.plan);

  PENUMBRA_TRY_VOID(check_camera(name));
  PENUMBRA_TRY(auto context, open_run_context({request.window, request.vsync},
                                              {camera.width(), camera.height()}));
  print_tags(used_tags);
  SessionOptions session_options;
  session_options.plan = request.plan;
  session_options.rectified = request.rectified;
  session_options.video_light = request.video_light;
  session_options.msaa = request.msaa;
  session_options.pixel_buffers = request.pixel_buffers;
  session_options.smooth = request.smooth;
  PENUMBRA_TRY(auto session,
               Session::create(*context, scene, camera, std::move(*tracker), session_options));
  // Before the camera starts: what it gives first would be old by the time it is drawn.
  PENUMBRA_TRY_VOID(session.warm_up(PixelFormat::yuv420p));

  PENUMBRA_TRY(auto source, open_camera(name, request, wish_for(camera)));
  PENUMBRA_TRY_VOID(check_size_or_offer(request, name, source->format(), camera));
  log_info("{}", source->description());

  std::vector<std::filesystem::path> taken = {request.scene, request.calibration, request.tags};
  if (request.kernel_file) taken.push_back(*request.kernel_file);
  if (request.record) taken.push_back(*request.record);
  if (name.kind == CameraName::Kind::recording) {
    PENUMBRA_TRY(const auto played, open_as_camera(name));
    for (const std::string& notice : played.notices) log_warning("{}", notice);
    PENUMBRA_TRY_VOID(check_apart_from(played, request, request.record));
    for (std::filesystem::path& file : files_of(played)) taken.push_back(std::move(file));
  }
  PENUMBRA_TRY_VOID(check_output_paths(request, std::move(taken)));
  PENUMBRA_TRY_VOID(check_apart_from_record(request));
  interrupt.hold();
  auto outputs =
      open_outputs(request, {camera.width(), camera.height(), source->format().interval_s},
                   other_groups(tags), kEncodeAhead);
  if (!outputs) return tl::unexpected(outputs.error());
  PENUMBRA_TRY(auto head, recording_head(request, *source, camera));
  LiveRecorder recorder(std::move(head));
  if (request.record) {
    PENUMBRA_TRY_VOID(recorder.start(*request.record));
  }

  RunRecorder run({camera});
  LiveHost host(session, run, *source, recorder, request);
  std::optional<Viewer> viewer;
  if (context->window_size().width > 0) {
    PENUMBRA_TRY(auto overlay, Overlay::create(*context));
    viewer.emplace(*context, host, std::move(overlay), request.viewer);
  }
  std::vector<std::uint8_t> pixels;
  if (outputs->frames) {
    pixels.resize(static_cast<std::size_t>(camera.width()) *
                  static_cast<std::size_t>(camera.height()) * 4U);
  }

  LateOutputs late(&session, *outputs, run);
  Silence silence;
  bool stopped = false;
  // What went wrong first; what was made until then is kept.
  std::optional<Error> failure;
  const auto keep_on = [&](const Result<void>& written) {
    if (written) return;
    log_warning("{}; this output is closed, the session continues", written.error().message);
    if (!failure) failure = written.error();
    if (!outputs->frames) pixels.clear();
  };
  // What was taken before a person paused and is shown after: its age is no latency.
  std::int64_t paused_until_ns = std::numeric_limits<std::int64_t>::min();
  const auto show = [&](Viewer::Picture picture) {
    if (!viewer) return;
    const double paused_ms = viewer->paused_ms();
    if (!viewer->show(interrupt, picture)) stopped = true;
    if (viewer->paused_ms() > paused_ms) paused_until_ns = monotonic_ns();
  };
  ImageFaultWatch pictures(tags);
  LivePipeline pipeline(
      *source,
      [&](const Frame& frame) {
        TrackedFrame tracked = session.track(frame);
        pictures.saw(tracked);
        return tracked;
      },
      [&](const CapturedImage& image) {
        if (const auto writer = recorder.writer()) writer->add_image(image);
      },
      request.threads > 1);
  while (!stopped && !pipeline.finished()) {
    auto ready = pipeline.take(kPatience);
    for (const auto& event : source->faults().take_events()) {
      if (const auto writer = recorder.writer()) {
        writer->add_event(event.timestamp_ns, name_of(event.fault), event.detail);
      }
    }
    if (ready) {
      host.is_live();
      if (run.frames() == 0) {
        if (const auto warning = focus_warning(request.calibration, source->focus())) {
          log_warning("{}", *warning);
        }
      }
      const Stopwatch watch;
      const std::int64_t timestamp_ns = ready->tracked.frame.timestamp_ns;
      run.add_time("capture", ready->capture_time);
      silence.saw(ready->tracked);
      auto done = session.draw(std::move(ready->tracked), pixels, PictureTime::later);
      if (!done) {
        failure = done.error();
        break;
      }
      run.add_frame(*done);
      recorder.add(*done, session);
      if (viewer) host.saw(*done);
      show(Viewer::Picture::next);
      // From the driver's stamp to the picture's being on the screen (or, offscreen, drawn).
      const bool paused = timestamp_ns <= paused_until_ns;
      if (!paused) {
        // Some drivers stamp a frame with the moment at which it is going to end.
        const std::int64_t age_ns = std::max<std::int64_t>(monotonic_ns() - timestamp_ns, 0);
        run.add_time("latency", {static_cast<double>(age_ns) * 1e-6, 0.0});
      }
      keep_on(late.write(*done, pixels));
      if (!paused) run.add_time("frame", watch.elapsed());
    } else {
      keep_on(late.write_rest());  // no next frame came soon
      const auto silence_ns = pipeline.stale_for_ns();
      if (silence_ns) host.is_stale(*silence_ns);
      if (auto picture = silence_ns ? silence.picture(*silence_ns) : std::nullopt) {
        auto drawn = session.redraw(std::move(*picture));
        if (!drawn) {
          failure = drawn.error();
          break;
        }
        if (viewer) host.saw(*drawn);
        if (!silence.holds()) host.forget_frame();
      }
      show(Viewer::Picture::same);
    }
    if (host.is_over() || interrupt.interrupted()) stopped = true;
  }
  pipeline.stop();
  if (!failure) failure = display_loss(*context);
  if (const auto error = pipeline.error(); error && !failure) failure = error;

  if (const auto rest = late.write_rest(); !rest && !failure) failure = rest.error();
  // Of no frame there is nothing to be written.
  if (const auto finished = outputs->finish(run); !finished && !failure && run.frames() > 0) {
    failure = finished.error();
  }
  run.add_gpu_times(session.take_gpu_times());
  const CaptureStats stats = source->faults().stats();
  RunReport report = run.report();
  report.recording = request.camera;
  report.scene = request.scene.string();
  report.tags = used_tags;
  report.image_fault = pictures.fault();
  report.width = camera.width();
  report.height = camera.height();
  report.frames_captured = static_cast<int>(stats.frames);
  report.frames_dropped = report.frames_captured - report.frames;
  report.frames_damaged = static_cast<int>(stats.undecoded);
  report.interrupted = interrupt.interrupted();
  report.log_lines_dropped = dropped_log_lines();
  report.threads = request.threads;
  report.msaa_samples = session.samples();
  report.pixel_buffers = session.pixel_buffers();
  report.gl_renderer = context->info().renderer;
  report.gl_version = context->info().version;
  for (std::size_t i = 0; i < kCaptureFaultCount; ++i) {
    if (stats.faults[i] == 0) continue;
    report.camera_faults[std::string(name_of(static_cast<CaptureFault>(i)))] =
        static_cast<std::int64_t>(stats.faults[i]);
  }
  if (stats.restarts > 0) {
    report.camera_faults["restarts"] = static_cast<std::int64_t>(stats.restarts);
  }
  const auto recorded = recorder.finish();
  if (const RecordedFrames frames = recorder.frames(); frames.written + frames.left_out > 0) {
    report.recorded = frames;
  }
  // Printed last: a terminal that stalls must not keep the report from being written.
  const auto print_recordings = [&recorder] {
    for (const std::string& summary : recorder.summaries()) fmt::print("{}\n", summary);
  };
  if (report.frames == 0) {
    print_recordings();
    if (failure) return tl::unexpected(*failure);
    return fail("{}{}", no_frame_text(request, stats, host.is_over()),
                recorded ? std::string() : "; and " + recorded.error().message);
  }
  if (!recorded && !failure) failure = recorded.error();
  report.failure = std::move(failure);
  if (auto written = outputs->write_report(report); !written && !report.failure) {
    report.failure = written.error();
  }
  print_recordings();
  return report;
}

}  // namespace penumbra
