// penumbra demo: the bundled recording with the bundled scene, nothing to type.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <memory>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/output/frame_writer.hpp"
#include "app/replay/replay_run.hpp"
#include "app/resources.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

struct DemoOptions {
  std::filesystem::path output = "penumbra-demo.mp4";
  ShadowChoice shadow;
  PlanOptions plan;
  bool no_window = false;
};

Result<ExitCode> demo(const DemoOptions& options) {
  PENUMBRA_TRY(const auto resources, find_resources());
  ReplayRequest request;
  request.recording = resources / "recordings" / "tabletop";
  request.scene = resources / "scenes" / "default.json";
  request.output = options.output;
  request.plan = options.plan;
  request.kernel_file = options.shadow.kernel_file;
  request.window = !options.no_window;

  PENUMBRA_TRY(const auto report, run_replay(request));
  if (report.failure) {
    fmt::print("{}", report_table(report));
    return tl::unexpected(*report.failure);
  }
  fmt::print("{}\nvideo: {}\n", report_table(report),
             std::filesystem::absolute(options.output).lexically_normal().string());
  return ExitCode::success;
}

}  // namespace

void add_demo_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command = program.add_subcommand(
      "demo",
      "Replay the bundled recording with the bundled scene; write a video and show what was "
      "measured");
  add_common_options(*command);
  const auto options = std::make_shared<DemoOptions>();
  command
      ->add_option_function<std::string>(
          "--output",
          [options](const std::string& path) {
            if (output_kind(path) == OutputKind::folder) {
              throw CLI::ValidationError(
                  "--output", fmt::format("{}: must end in .mp4 (H.264) or .mkv (FFV1)", path));
            }
            options->output = path;
          },
          "The composited video: *.mp4 (H.264) or *.mkv (FFV1, lossless)")
      ->type_name("PATH")
      ->default_str(options->output.string());
  add_shadow_options(*command, options->shadow);
  command->add_flag("--no-window", options->no_window, "Offscreen, also where there is a display");
  command->footer(
      "The last line of the output names the video. In the window F1 lists the keys.\n"
      "Ctrl-C ends early; the video holds the frames up to then.\n\n"
      "Example:\n"
      "  penumbra demo --output demo.mp4");
  command->callback([options, &chosen] {
    warn_of_no_use(options->shadow);
    apply(options->shadow, options->plan);  // wrong usage ends here
    chosen = [options] { return demo(*options); };
  });
}

}  // namespace penumbra
