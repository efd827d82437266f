// penumbra replay RECORDING: augments a recording in a window; writes video, poses, report.

#include <algorithm>
#include <array>
#include <memory>
#include <ranges>
#include <string_view>

#include "app/commands/options.hpp"
#include "app/logging.hpp"
#include "app/recording/session_record.hpp"
#include "app/replay/replay_run.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

struct ReplayOptions {
  ReplayRequest request;
  ShadowChoice shadow;
  std::vector<std::string> compare;
  std::optional<SessionRecord> session;  // that the recording keeps
};

// Returns the panes of --compare. --kernels and --light-mode apply to every pane except `cocl`,
// which always uses CoCL kernels.
std::vector<ComparedTechnique> compared(const ReplayOptions& options) {
  std::vector<ComparedTechnique> techniques;
  for (const std::string& name : options.compare) {
    ShadowChoice choice = options.shadow;
    set_technique(choice, "--compare", name);
    if (choice.cocl) {
      choice.plan.kernels.reset();
      choice.kernel_file.reset();
      choice.plan.light_mode.reset();
    }
    if (std::ranges::count(techniques, name, &ComparedTechnique::name) > 0) {
      usage_error("--compare", "{}: is named twice", name);
    }
    techniques.push_back({name, plan_of(choice)});
  }
  if (!techniques.empty() && (techniques.size() < kMinPanes || techniques.size() > kMaxPanes)) {
    usage_error("--compare", "{} techniques; give {} to {}, with commas between them",
                techniques.size(), kMinPanes, kMaxPanes);
  }
  return techniques;
}

// Reads the session that a recording keeps, and sets its options where the user gives none.
Result<void> take_session(CLI::App& command, ReplayOptions& options) {
  PENUMBRA_TRY(options.session, load_session_record(options.request.recording));
  if (!options.session) return {};
  constexpr std::array<std::string_view, 3> kOfTracking = {"--tracking", "--pose-budget",
                                                           "--smooth"};
  for (const auto& [name, value] : options.session->options) {
    CLI::Option* option = command.get_option_no_throw(name);
    const bool excluded = (name == "--shadow" && !options.compare.empty()) ||
                          (options.request.poses_from && std::ranges::count(kOfTracking, name) > 0);
    if (option == nullptr || option->count() > 0 || excluded) continue;
    try {
      option->add_result(value);
      option->run_callback();
    } catch (const CLI::Error& error) {
      return fail("{}: options: {}; correct the value or remove it",
                  (options.request.recording / "session.json").string(), error.what());
    }
  }
  return {};
}

// Returns the scene of a recorded session that added objects to it; empty for other recordings.
// Recordings of earlier versions have no session.json.
std::filesystem::path recorded_scene(const std::filesystem::path& recording) {
  const auto events = load_scene_events(recording / "events.jsonl");
  if (!events || !adds_objects(*events)) return {};
  return events->scene;
}

Result<ExitCode> replay(const ReplayOptions& options) {
  ReplayRequest request = options.request;
  if (options.session) {
    for (const std::string& warning : options.session->warnings) log_warning("{}", warning);
    if (request.scene.empty()) request.scene = options.session->scene;
  }
  if (request.scene.empty() && request.edits) {
    request.scene = recorded_scene(request.recording);
  }
  PENUMBRA_TRY_VOID(complete(request));
  PENUMBRA_TRY(const auto report, run_replay(request));
  fmt::print("{}", report_table(report));
  if (report.failure) return tl::unexpected(*report.failure);
  fmt::print("{}", written_files(request));
  return ExitCode::success;
}

}  // namespace

void add_replay_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "replay", "Replay a recorded session: track, composite, show or write",
      "In the window: F1 lists the keys, space pauses, Esc or q closes. "
      "Ctrl-C ends early; the files hold the frames up to then, and the report says so.\n\n"
      "Example:\n"
      "  penumbra replay recordings/tabletop --output out.mkv --poses out.tum --report "
      "report.json\n"
      "  penumbra replay recordings/tabletop --shadow volume --output volume.mp4\n"
      "  penumbra replay recordings/tabletop --compare layered,simple,walls,hard --output "
      "compare.mp4");
  const auto options = std::make_shared<ReplayOptions>();
  ReplayRequest& request = options->request;

  add_option(command, "RECORDING", "FOLDER|VIDEO", request.recording,
             "The recording: a folder, or a video file")
      ->required();
  add_scene_option(command, request,
                   "Scene to draw (default: the recording's, else the program's own)");
  add_object_option(command, request.objects);
  add_option(command, "--tags", "FILE.yaml", request.tags, "Tag map (default: the recording's)");
  add_option(command, "--calibration", "camera.yaml", request.camera,
             "Camera model (default: the recording's)")
      ->group("Input");
  add_camera_name_option(command, request.camera_name)->group("Input");
  CLI::Option* shadow = add_shadow_options(command, options->shadow);
  const auto add_compared = [options](const std::string& list) {
    for (const auto part : std::views::split(list, ',')) {
      const std::string name(part.begin(), part.end());
      options->compare.push_back(name.substr(std::min(name.find_first_not_of(' '), name.size())));
    }
  };
  add_text_option(command, "--compare", "TECHNIQUE,...", add_compared,
                  fmt::format("{} to {} techniques side by side, at the same poses and times",
                              kMinPanes, kMaxPanes))
      ->excludes(shadow);
  add_tracking_options(command, request.tracking);
  CLI::Option* refine = add_refine_map_option(command, request);
  CLI::Option* smooth = add_smooth_option(command, request.smooth);
  add_poses_from_option(command, request.poses_from)->excludes(smooth)->excludes(refine);
  add_output_options(command, request);
  start_group(command, "Input");
  add_frames_option(command, request.frames);
  command.add_flag("--realtime", request.realtime,
                   "At the pace it was recorded (always so in a window)");
  add_off_flag(command, "--no-edits", request.edits, "Ignore the edits that were recorded");
  add_frame_options(command, request, options->shadow);
  add_pairing_options(command, request.pairing);
  add_window_options(command, request);
  put_first(command, {"--shadow", "--compare", "--tracking", "--output", "--poses", "--report",
                      "--poses-from", "--frames"});
  command.callback([&command, options, &chosen] {
    claim_outputs(command, {"--poses", "--frame-log", "--report", "--refine-map", "--refine-camera",
                            "--save-scene"});
    options->request.chosen_view = {
        .translucency = command.count("--translucency") > 0,
        .walls = command.count("--hide-walls") > 0,
        .smooth = command.count("--smooth") > 0 || options->request.poses_from.has_value()};
    if (const auto taken = take_session(command, *options); !taken) {
      chosen = [error = taken.error()]() -> Result<ExitCode> { return tl::unexpected(error); };
      return;
    }
    set_run_options(command, options->shadow, options->request);
    options->request.compare = compared(*options);
    chosen = [options] { return replay(*options); };
  });
}

}  // namespace penumbra
