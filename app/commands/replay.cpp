// penumbra replay RECORDING: a recorded session -> window, video, poses, report.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/replay/replay_run.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

struct ReplayOptions {
  ReplayRequest request;
  RunChoice run;
  std::vector<std::string> compare;
  bool no_edits = false;
};

// The panes of --compare. What --kernels and --light-mode say is of every pane, but for cocl, which
// has kernels of its own.
std::vector<ComparedTechnique> compared(const ReplayOptions& options) {
  std::vector<ComparedTechnique> techniques;
  for (const std::string& name : options.compare) {
    ShadowChoice choice = options.run.shadow;
    set_technique(choice, "--compare", name);
    if (choice.cocl) {
      choice.kernels.reset();
      choice.kernel_file.reset();
      choice.light_mode.reset();
    }
    const bool again =
        std::ranges::find(techniques, name, &ComparedTechnique::name) != techniques.end();
    if (again) {
      throw CLI::ValidationError("--compare", fmt::format("{}: is named twice", name));
    }
    ComparedTechnique& technique = techniques.emplace_back();
    technique.name = name;
    technique.plan = options.request.plan;
    apply(choice, technique.plan);
  }
  if (!techniques.empty() && (techniques.size() < kLeastPanes || techniques.size() > kMostPanes)) {
    throw CLI::ValidationError("--compare",
                               fmt::format("{} techniques; give {} to {}, with commas between them",
                                           techniques.size(), kLeastPanes, kMostPanes));
  }
  return techniques;
}

Result<ExitCode> replay(const ReplayOptions& options) {
  ReplayRequest request = options.request;
  PENUMBRA_TRY_VOID(complete(options.run, request));
  for (ComparedTechnique& technique : request.compare) technique.plan.skip = request.plan.skip;
  request.edits = !options.no_edits;

  PENUMBRA_TRY(const auto report, run_replay(request));
  fmt::print("{}", report_table(report));
  if (report.failure) return tl::unexpected(*report.failure);
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
  add_scene_option(*command, options->run);
  command->add_option("--tags", request.tags, "What lies on the table (default: the recording's)")
      ->type_name("FILE.yaml");
  add_camera_name_option(*command, request.camera_name);
  CLI::Option* shadow = add_shadow_options(*command, options->run.shadow);
  command
      ->add_option_function<std::string>(
          "--compare",
          [options](const std::string& list) {
            for (std::size_t at = 0; at <= list.size();) {
              const std::size_t end = std::min(list.find(',', at), list.size());
              const std::size_t first = std::min(list.find_first_not_of(' ', at), end);
              options->compare.push_back(list.substr(first, end - first));
              at = end + 1;
            }
          },
          fmt::format("{} to {} techniques of --shadow side by side in one picture, each under its "
                      "name: the same poses and times in every pane",
                      kLeastPanes, kMostPanes))
      ->excludes(shadow)
      ->type_name("TECHNIQUE,...");
  add_tracking_options(*command, request.tracking);
  add_output_options(*command, request);
  CLI::Option* smooth = add_smooth_option(*command, request.smooth);
  command
      ->add_option("--poses-from", request.poses_from,
                   "Draw with given poses instead of tracking: groundtruth (the recording's), or a "
                   "TUM file")
      ->excludes(smooth)
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
  add_frame_options(*command, request, options->run,
                    "frames are decoded, tracked, drawn and encoded side by side");
  add_pairing_options(*command, request.pairing);
  command->add_flag("--realtime", request.realtime,
                    "At the pace it was recorded (always so in a window)");
  add_window_options(*command, options->run);
  command->add_flag("--no-edits", options->no_edits,
                    "Leave out what was moved and changed while it was recorded");
  command->footer(
      "In the window: F1 lists the keys, space pauses, Esc or q closes.\n"
      "Ctrl-C ends early; the files hold the frames up to then, and the report says so.\n\n"
      "Example:\n"
      "  penumbra replay recordings/tabletop --output out.mkv --poses out.tum --report "
      "report.json\n"
      "  penumbra replay recordings/tabletop --shadow volume --output volume.mp4\n"
      "  penumbra replay recordings/tabletop --compare layered,simple,walls,hard --output "
      "compare.mp4");
  command->callback([command, options, &chosen] {
    claim_outputs(*command, {"--poses", "--report"});
    warn_of_no_use(options->run.shadow);
    warn_of_no_use(*command, options->request.tracking);
    apply(options->run.shadow, options->request.plan);  // wrong usage ends here
    options->request.compare = compared(*options);
    chosen = [options] { return replay(*options); };
  });
}

}  // namespace penumbra
