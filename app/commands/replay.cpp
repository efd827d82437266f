// penumbra replay RECORDING: a recorded session -> window, video, poses, report.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <cstdio>
#include <memory>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/replay_run.hpp"
#include "app/resources.hpp"

namespace penumbra {
namespace {

struct ReplayOptions {
  ReplayRequest request;
  std::optional<std::filesystem::path> scene;
  ShadowChoice shadow;
  bool no_skip = false;
  bool no_window = false, no_hud = false, no_edits = false;
};

Result<ExitCode> replay(const ReplayOptions& options) {
  ReplayRequest request = options.request;
  if (options.scene) {
    request.scene = *options.scene;
  } else {
    const auto resources = find_resources();
    if (!resources) return tl::unexpected(resources.error());
    request.scene = *resources / "scenes" / "default.json";
  }
  request.kernel_file = options.shadow.kernel_file;
  request.plan.skip = !options.no_skip;
  request.window = !options.no_window;
  request.viewer.hud = !options.no_hud;
  request.edits = !options.no_edits;

  const auto report = run_replay(request);
  if (!report) return tl::unexpected(report.error());
  fmt::print("{}", report_table(*report));
  return ExitCode::success;
}

}  // namespace

void add_replay_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command = program.add_subcommand(
      "replay", "Replay a recorded session: track, composite, show or write");
  add_common_options(*command);
  const auto options = std::make_shared<ReplayOptions>();
  ReplayRequest& request = options->request;

  command->add_option("RECORDING", request.recording, "The recording")
      ->required()
      ->type_name("FOLDER");
  command->add_option("--scene", options->scene, "Scene to draw (default: the program's own)")
      ->type_name("FILE.json");
  command->add_option("--tags", request.tags, "What lies on the table (default: the recording's)")
      ->type_name("FILE.yaml");
  add_shadow_options(*command, options->shadow);
  add_tracking_option(*command, request.tracking.mode);
  add_output_options(*command, request);
  command
      ->add_option("--poses-from", request.poses_from,
                   "Draw with given poses instead of tracking: groundtruth (the recording's), or a "
                   "TUM file")
      ->type_name("groundtruth|FILE.tum");
  command
      ->add_option_function<std::string>(
          "--frames",
          [&request](const std::string& text) {
            const auto range = parse_frame_range(text);
            if (!range) {
              throw CLI::ValidationError(
                  "--frames",
                  fmt::format("{}: is no range A:B with A < B (half open: A to B - 1)", text));
            }
            request.frames = *range;
          },
          "Only frames numbered A to B - 1; either may be left out")
      ->type_name("A:B");
  command
      ->add_option("--threads", request.threads,
                   "1: one stage after another; more: frames are decoded, tracked, drawn and "
                   "encoded side by side. The results are the same")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str()
      ->type_name("N");
  command->add_flag("--no-skip", options->no_skip,
                    "Do all work, also what can't be seen; the results are the same");
  command->add_flag("--realtime", request.realtime,
                    "At the pace it was recorded (always so in a window)");
  command->add_flag("--no-window", options->no_window, "Offscreen, also where there is a display");
  command->add_flag("--no-hud", options->no_hud,
                    "The window's HUD is hidden at first (H shows it)");
  command->add_flag("--no-edits", options->no_edits,
                    "Leave out what was moved and changed while it was recorded");
  command->footer(
      "In the window: F1 lists the keys, space pauses, Esc or q closes.\n"
      "Ctrl-C ends early; the files hold the frames up to then, and the report says so.\n\n"
      "Example:\n"
      "  penumbra replay recordings/tabletop --output out.mkv --poses out.tum --report "
      "report.json\n"
      "  penumbra replay recordings/tabletop --shadow volume --output volume.mp4");
  command->callback([options, &chosen] {
    apply(options->shadow, options->request.plan);  // wrong usage ends here
    chosen = [options] { return replay(*options); };
  });
}

}  // namespace penumbra
