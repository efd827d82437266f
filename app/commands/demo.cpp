// penumbra demo: replays the bundled recording with the bundled scene.

#include <memory>

#include "app/commands/options.hpp"
#include "app/output/frame_writer.hpp"
#include "app/replay/replay_run.hpp"
#include "app/resources.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

struct DemoOptions {
  DemoOptions() { request.output = "penumbra-demo.mp4"; }
  ReplayRequest request;
  ShadowChoice shadow;
};

Result<ExitCode> demo(const DemoOptions& options) {
  PENUMBRA_TRY(const auto resources, find_resources());
  ReplayRequest request = options.request;
  PENUMBRA_TRY(request.recording, find_bundled_recording_in(resources, "tabletop"));
  request.scene = bundled_scene(resources, request.objects);
  PENUMBRA_TRY(const auto report, run_replay(request));
  if (report.failure) {
    fmt::print("{}", report_table(report));
    return tl::unexpected(*report.failure);
  }
  fmt::print("{}\nvideo: {}\n", report_table(report),
             std::filesystem::absolute(*request.output).lexically_normal().string());
  return ExitCode::success;
}

}  // namespace

void add_demo_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "demo",
      "Replay the bundled recording with the bundled scene; write a video and show what was "
      "measured",
      "The last line of the output names the video. In the window F1 lists the keys. "
      "Ctrl-C ends early; the video holds the frames up to then.\n\n"
      "Example:\n"
      "  penumbra demo --output demo.mp4");
  const auto options = std::make_shared<DemoOptions>();
  const auto set_output = [options](const std::string& path) {
    if (output_kind(path) == OutputKind::folder) {
      usage_error("--output", "{}: must end in .mp4 (H.264) or .mkv (FFV1)", path);
    }
    options->request.output = path;
  };
  add_text_option(command, "--output", "PATH", set_output,
                  "Composited video: *.mp4 (H.264) or *.mkv (FFV1)")
      ->default_str(options->request.output->string());
  add_object_option(command, options->request.objects);
  add_shadow_options(command, options->shadow);
  add_off_flag(command, "--no-window", options->request.window,
               "Offscreen, even if there is a display");
  put_first(command, {"--object", "--shadow", "--no-window"});
  command.callback([&command, options, &chosen] {
    set_run_options(command, options->shadow, options->request);
    chosen = [options] { return demo(*options); };
  });
}

}  // namespace penumbra
