#include "app/study/study_run.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <thread>
#include <utility>

#include "app/interrupt.hpp"
#include "app/live/live_pipeline.hpp"
#include "app/logging.hpp"
#include "app/output/output_file.hpp"
#include "app/replay/replay_poses.hpp"
#include "app/replay/replay_run.hpp"
#include "app/run_inputs.hpp"
#include "app/session/session.hpp"
#include "app/study/scripted_participant.hpp"
#include "app/study/study_feed.hpp"
#include "app/study/study_task.hpp"
#include "app/window/hud.hpp"
#include "app/window/overlay.hpp"
#include "app/window/pointer.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

// Longest time that a scripted participant waits for an image with a pose.
constexpr std::int64_t kPatience_ns = 30'000'000'000;
// Interval of polling for events until the next image is due.
constexpr std::chrono::milliseconds kPoll(1);

// Runs the trials. A person's times are measured on the monotonic clock, from the buffer swap of
// the first image of the trial to the event. A script's times use the images' clock, so that they
// do not depend on the machine's speed.
class StudyLoop {
 public:
  StudyLoop(GlContext& context, Session& session, StudyFeed& feed, StudyTask& task, StudyFile& file,
            std::unique_ptr<Overlay> overlay, std::optional<ScriptedParticipant> script,
            double pause_s)
      : context_(context),
        session_(session),
        feed_(feed),
        task_(task),
        file_(file),
        overlay_(std::move(overlay)),
        script_(std::move(script)),
        pause_ns_(nanoseconds(pause_s)) {
    context_.on_event([this](const WindowEvent& event) {
      const auto command = command_of_key(event);
      if (command == WindowCommand::quit) {
        closed_ = true;
      } else if (command == WindowCommand::full_screen) {
        context_.toggle_full_screen();
      } else if (!script_) {
        take(event, monotonic_ns());
      }
    });
  }
  StudyLoop(const StudyLoop&) = delete;
  StudyLoop& operator=(const StudyLoop&) = delete;
  ~StudyLoop() { context_.on_event({}); }

  [[nodiscard]] Result<void> run(InterruptWatch& interrupt) {
    begin_block();
    while (!task_.finished() && !closed_ && !interrupt.interrupted()) {
      if (phase_ == Phase::pause && time_ns() >= pause_ends_ns_) begin_trial();
      PENUMBRA_TRY(auto image, feed_.next());
      if (!image) {
        poll();
        continue;
      }
      if (script_) {
        PENUMBRA_TRY_VOID(act_until(image->clock_ns));
        if (task_.finished()) break;
        clock_ns_ = image->clock_ns;
      } else if (feed_.produces_on_demand()) {
        wait_for(image->clock_ns);
        if (task_.finished()) break;
      }
      PENUMBRA_TRY_VOID(show(image->frame));
      if (failure_) return tl::unexpected(*failure_);
    }
    if (failure_) return tl::unexpected(*failure_);
    return {};
  }

 private:
  // ready: waits until the person starts the block. pause: no spheres are shown. trial: the trial
  // is shown, from the first image with a pose on.
  enum class Phase { ready, pause, trial };

  [[nodiscard]] std::int64_t time_ns() const { return script_ ? clock_ns_ : monotonic_ns(); }
  [[nodiscard]] GlContext::Size window() const {
    const GlContext::Size size = context_.window_size();
    // Offscreen, the image replaces the window.
    if (size.width <= 0) return {session_.camera().width(), session_.camera().height()};
    return size;
  }

  void begin_block() {
    phase_ = script_ ? Phase::pause : Phase::ready;
    pause_ends_ns_ = time_ns();
  }
  void begin_trial() {
    for (const SceneEdit& edit : task_.set_up(*session_.view().scene)) session_.edit(edit);
    feed_.rewind();
    phase_ = Phase::trial;
    trial_began_ns_.reset();
  }

  void poll() {
    if (!context_.poll_events()) closed_ = true;
  }

  // Waits until the image is due. A late image delays all later ones.
  void wait_for(std::int64_t clock_ns) {
    const std::int64_t now = monotonic_ns();
    due_ns_ = last_clock_ns_ ? std::max(now, due_ns_ + clock_ns - *last_clock_ns_) : now;
    last_clock_ns_ = clock_ns;
    while (monotonic_ns() < due_ns_ && !closed_) {
      std::this_thread::sleep_for(kPoll);
      poll();
    }
  }

  // Executes the script's actions up to this time on the shown image.
  [[nodiscard]] Result<void> act_until(std::int64_t clock_ns) {
    if (!task_.shown()) {
      if (phase_ != Phase::trial) return {};
      if (!trial_began_ns_) trial_began_ns_ = clock_ns;
      if (clock_ns - *trial_began_ns_ > kPatience_ns) {
        return fail("{}: the table was not seen for {:.0f} s; choose a recording that shows it",
                    script_->name(), seconds(kPatience_ns));
      }
      return {};
    }
    const int trial = task_.trial().number;
    while (const ScriptAction* action = script_->take(trial, clock_ns - task_.shown_ns())) {
      PENUMBRA_TRY(const auto events, script_->events_of(*action, session_.view(), window()));
      for (const WindowEvent& event : events) take(event, task_.shown_ns() + action->at_ns);
      if (failure_) return tl::unexpected(*failure_);
      if (task_.finished() || task_.trial().number != trial) return {};
    }
    if (!script_->has_more(trial)) {
      return fail("{}: its actions in trial {} give no answer; add the missing ones",
                  script_->name(), trial);
    }
    return {};
  }

  void take(const WindowEvent& event, std::int64_t time_ns) {
    using Kind = WindowEvent::Kind;
    switch (event.kind) {
      case Kind::key_down:
        if (command_of_key(event) != WindowCommand::pause) break;  // space bar
        if (end_ready(time_ns)) break;
        apply_outcome(task_.accept(time_ns), time_ns);
        break;
      case Kind::button_down:
        if (!end_ready(time_ns)) press(event, time_ns);
        break;
      case Kind::pointer_moved:
        move(event, time_ns);
        break;
      case Kind::button_up:
        if (event.code != button_) break;
        move(event, time_ns);
        button_ = -1;
        apply_outcome(task_.release(time_ns), time_ns);
        break;
      default:
        break;
    }
  }
  bool end_ready(std::int64_t time_ns) {
    if (phase_ != Phase::ready) return false;
    phase_ = Phase::pause;
    pause_ends_ns_ = time_ns + pause_ns_;
    return true;
  }
  void press(const WindowEvent& event, std::int64_t time_ns) {
    pointer_ = {event.x, event.y};
    const SessionView view = session_.view();
    const auto pointer = pointer_in_window(view, window(), pointer_);
    if (!pointer || task_.holding()) return;
    // As in the paper, each button moves the ball along two axes. A handheld camera may see the
    // paper's y-z and x-z planes edge-on, so here the axes are up and sideways in the view.
    const bool lift = event.code != WindowEvent::kLeft || event.shift || event.control;
    apply_outcome(task_.press(*view.scene, *pointer, lift, time_ns), time_ns);
    if (task_.holding()) button_ = event.code;
  }
  // If only the camera moves and not the pointer, the ball keeps its position on the table.
  void move(const WindowEvent& event, std::int64_t time_ns) {
    const Eigen::Vector2d at(event.x, event.y);
    if (at == std::exchange(pointer_, at) || !task_.holding()) return;
    if (const auto pointer = pointer_in_window(session_.view(), window(), at)) {
      apply_outcome(task_.move(*pointer), time_ns);
    }
  }

  void apply_outcome(StudyTask::Outcome outcome, std::int64_t time_ns) {
    for (const SceneEdit& edit : outcome.edits) session_.edit(edit);
    if (auto added = file_.append(outcome.rows); !added) failure_ = added.error();
    if (!outcome.over) return;
    button_ = -1;
    if (task_.finished()) return;
    phase_ = Phase::pause;
    pause_ends_ns_ = time_ns + pause_ns_;
    if (task_.trial().trial == 1) begin_block();
  }

  [[nodiscard]] Result<void> show(const Frame& frame) {
    TrackedFrame tracked = session_.track(frame);
    const TrackStatus status = tracked.pose.status;
    const bool visible = phase_ == Phase::trial &&
                         (task_.shown() ? tracked.pose.has_pose() : status == TrackStatus::tracked);
    if (!visible) {  // a lost pose: the image is drawn without objects
      tracked.pose.status = TrackStatus::lost;
      tracked.pose.reason = {PoseCause::no_trial};
    }
    PENUMBRA_TRY_VOID(session_.draw(std::move(tracked)));
    if (context_.window_size().width > 0) {
      session_.present();
      if (overlay_) {
        overlay_->draw_text(instructions(status), phase_ == Phase::ready, context_.window_size());
      }
      context_.swap();
    }
    if (phase_ == Phase::trial) {
      if (!task_.shown() && visible) task_.show(time_ns());
      task_.count_frame(visible);
    }
    poll();
    return {};
  }

  // Returns a text with the task, without revealing the technique.
  [[nodiscard]] std::string instructions(TrackStatus status) const {
    const StudyTrial& trial = task_.trial();
    const StudyDesign& design = task_.plan().design;
    const bool heights = design.experiment == StudyExperiment::heights;
    if (phase_ == Phase::ready) {
      const std::string task =
          heights ? "You will see three spheres. Click on the one that is highest above the table."
                  : "Drag the red sphere onto the green one, then onto the next green one, until "
                    "there are no more.\n"
                    "Left button: along the table. Middle or right button: up and sideways.\n"
                    "Space: you can't bring it any nearer.";
      return fmt::format(
          "Part {} of {}, {} trials\n\n{}\nBe quick, but make as few mistakes as you can.\n\nClick "
          "or press space to begin.",
          trial.block, design.techniques.size(), design.samples, task);
    }
    const bool seen = task_.shown() ? status != TrackStatus::lost : status == TrackStatus::tracked;
    const bool unseen = phase_ == Phase::trial && !seen;
    return fmt::format("{} of {}: {}", trial.trial, design.samples,
                       unseen    ? "hold the camera so that it sees the printed sheet"
                       : heights ? "click on the highest sphere"
                                 : "drag the red sphere onto the green one");
  }

  GlContext& context_;
  Session& session_;
  StudyFeed& feed_;
  StudyTask& task_;
  StudyFile& file_;
  std::unique_ptr<Overlay> overlay_;
  std::optional<ScriptedParticipant> script_;
  const std::int64_t pause_ns_;

  Phase phase_ = Phase::ready;
  std::int64_t pause_ends_ns_ = 0;
  std::optional<std::int64_t> trial_began_ns_;         // start of a script's trial
  std::int64_t clock_ns_ = 0;                          // time of the last image, images' clock
  std::int64_t due_ns_ = 0;                            // due time of last image, monotonic clock
  std::optional<std::int64_t> last_clock_ns_;          // images' clock in the last wait_for()
  Eigen::Vector2d pointer_ = Eigen::Vector2d::Zero();  // [px] of the window
  int button_ = -1;                                    // button that holds the ball
  bool closed_ = false;
  std::optional<Error> failure_;  // first error while an event was handled
};

struct StudyInput {
  CameraModel camera;
  PoseSource poses;
  std::unique_ptr<StudyFeed> feed;  // nullptr for a camera, which is opened last
};

Result<StudyInput> open_input(const StudyRequest& request, const Scene& scene) {
  if (!request.from_camera) {
    OpenRecordingOptions options;
    if (!request.camera.calibration.empty()) options.camera = request.camera.calibration;
    options.camera_name = request.camera.camera_name;
    options.tags = request.tags;
    options.require_tags = !request.poses_from;
    PENUMBRA_TRY(const auto recording, open_recording(request.recording, options));
    for (const std::string& notice : recording.notices) log_warning("{}", notice);
    if (!is_stream(request.results) && lies_in(request.results, recording.folder)) {
      return fail("{}: lies in the recording {}, which is only read; name a place outside it",
                  request.results.string(), recording.folder.string());
    }
    ReplayRequest replay;
    replay.tags = request.tags;
    replay.poses_from = request.poses_from;
    replay.tracking = request.tracking;
    PENUMBRA_TRY(auto poses, open_replay_poses(replay, recording, scene));
    return StudyInput{*recording.camera, std::move(poses),
                      feed_of_recording(recording, median_frame_interval_s(recording),
                                        request.poses_from.has_value())};
  }
  PENUMBRA_TRY(const auto camera,
               load_chosen_camera(request.camera.calibration, request.camera.camera_name));
  PENUMBRA_TRY(const auto tags, load_tag_map(*request.tags));
  auto tracker =
      GroupTracker::create(camera, tags, request.tracking,
                           wanted_groups(scene, tags, *request.tags, OutputRequest(), true));
  if (!tracker) return fail_in(request.tags->string(), tracker.error());
  return StudyInput{camera, std::move(*tracker), nullptr};
}

Result<void> check_paths(const StudyRequest& request) {
  std::vector<fs::path> read;
  for (const auto& file : {request.script, request.tags}) {
    if (file) read.push_back(*file);
  }
  if (request.poses_from) read.emplace_back(*request.poses_from);
  if (request.from_camera) read.push_back(request.camera.calibration);
  if (is_stream(request.results)) return {};
  for (const fs::path& written : {request.results, summary_path(request.results)}) {
    for (const fs::path& file : read) {
      if (same_path(written, file)) {
        return fail("{}: is read by this study; name another file", written.string());
      }
    }
  }
  return {};
}

}  // namespace

Result<StudyReport> run_study(const StudyRequest& request) {
  InterruptWatch interrupt;  // declared first: decoders and OpenGL start threads

  std::optional<ScriptedParticipant> script;
  if (request.script) {
    PENUMBRA_TRY(auto loaded, load_study_script(*request.script));
    script.emplace(std::move(loaded));
  } else if (!request.window) {
    return fail("--no-window: needs --script FILE, a scripted participant");
  } else if (!display_available()) {
    return fail(
        "a study needs a window, and there is no display (DISPLAY is not set); open one, or give "
        "--script FILE for a scripted participant");
  }
  PENUMBRA_TRY_VOID(check_paths(request));
  const auto scene = std::make_shared<const Scene>(study_scene(request.design.experiment));
  PENUMBRA_TRY(auto input, open_input(request, *scene));

  // A script does not need vertical synchronisation.
  PENUMBRA_TRY(auto context, open_run_context({request.window, !script},
                                              {input.camera.width(), input.camera.height()}));
  const bool has_window = context->window_size().width > 0;
  if (!script && !has_window) {
    return fail("a study needs a window, and none could be opened; see the line before");
  }
  PENUMBRA_TRY(auto session, Session::create(*context, scene, input.camera, std::move(input.poses),
                                             SessionOptions()));
  PENUMBRA_TRY_VOID(session.warm_up(PixelFormat::yuv420p));
  std::unique_ptr<Overlay> overlay;
  if (has_window) {
    PENUMBRA_TRY(overlay, Overlay::create(*context));
  }
  std::unique_ptr<StudyFeed> feed = std::move(input.feed);
  if (!feed) {
    PENUMBRA_TRY(auto source, open_live_source(request.camera, &input.camera));
    feed = feed_of_camera(std::move(source));
  }

  StudyReport report;
  std::optional<OutputFile> summary_file;  // summary beside the answers, unless they go to a stream
  if (!is_stream(request.results)) {
    report.summary_file = summary_path(request.results);
    PENUMBRA_TRY(summary_file, OutputFile::create(report.summary_file));
  }
  PENUMBRA_TRY(auto file, StudyFile::open(request.results, request.design, request.resume));
  const StudyPlan plan = plan_study(request.design);
  StudyTask task(plan, first_open_trial(plan, file.rows()));
  interrupt.hold();
  Result<void> done;
  if (!task.finished()) {
    StudyLoop loop(*context, session, *feed, task, file, std::move(overlay), std::move(script),
                   request.pause_s);
    done = loop.run(interrupt);
  }
  // A lost display replaces any other error, because it is the cause.
  if (auto lost = display_loss(*context)) done = tl::unexpected(*lost);
  report.trials = static_cast<int>(plan.trials.size());
  report.answered = static_cast<int>(first_open_trial(plan, file.rows()));
  report.summary = summarise(request.design, file.rows());
  if (summary_file) {
    const std::string text = summary_csv(study_name(request.design), report.summary);
    if (auto written = write_text(*summary_file, text); !written && done) done = written;
  }
  if (!done) return tl::unexpected(done.error());
  return report;
}

}  // namespace penumbra
