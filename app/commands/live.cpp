// penumbra live: a camera -> augmented video in a window, video, poses, report, recording.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <cmath>
#include <memory>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/live/live_run.hpp"
#include "app/tags_in_use.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

struct LiveOptions {
  LiveRequest request;
  std::optional<std::filesystem::path> calibration, tags;
  RunChoice run;
  bool no_vsync = false, no_dma_buf = false;
};

Result<ExitCode> live(const LiveOptions& options) {
  LiveRequest request = options.request;
  PENUMBRA_TRY_VOID(complete(options.run, request));
  if (!options.calibration) {
    return fail(
        "--calibration: no camera is calibrated yet; name the camera's camera.yaml, which "
        "penumbra calibrate makes");
  }
  request.camera.calibration = *options.calibration;
  PENUMBRA_TRY(request.tags,
               tags_for_camera(options.tags, request.camera.source, request.camera.calibration));
  request.camera.recorded = request.record.has_value();
  request.camera.dma_buf = !options.no_dma_buf;
  request.vsync = !options.no_vsync;

  PENUMBRA_TRY(const auto report, run_live(request));
  fmt::print("{}", report_table(report));
  if (report.failure) return tl::unexpected(*report.failure);
  // Without a duration, Ctrl-C is how a session ends.
  return ExitCode::success;
}

// "auto", or a number that `set` takes; false: neither.
template <class Set>
auto automatic_or_number(const char* option, bool& automatic, Set set) {
  return [option, &automatic, set](const std::string& text) {
    automatic = text == "auto";
    if (automatic) return;
    const auto number = parse_number(text);
    if (!number || !(*number >= 0.0 && *number <= 1e6)) {
      throw CLI::ValidationError(option, fmt::format("{}: is neither auto nor a number", text));
    }
    set(*number);
  };
}

// Of what a camera could be set to: empty, or what is wrong with it.
std::string plain_number(const std::string& text) {
  constexpr double kMost = 1e6;
  const auto number = parse_number(text);
  if (!number) return fmt::format("{}: is no number", text);
  if (!(std::abs(*number) <= kMost)) {
    return fmt::format("{}: is out of range; no camera has more than {:.0f} steps", text, kMost);
  }
  return {};
}

}  // namespace

void add_live_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command =
      program.add_subcommand("live", "Augment what a camera sees: track, composite, show, record");
  add_common_options(*command);
  const auto options = std::make_shared<LiveOptions>();
  LiveRequest& request = options->request;

  command
      ->add_option("--camera", request.camera.source,
                   "The camera: v4l2:/dev/video0, libcamera:0 or libcamera:NAME, or "
                   "recording:FOLDER to play a recording as if it were one, over and over")
      ->capture_default_str()
      ->type_name("CAMERA");
  command
      ->add_option("--calibration", options->calibration,
                   "The camera's model, at the size it gives (penumbra calibrate)")
      ->type_name("camera.yaml");
  add_camera_name_option(*command, request.camera.camera_name);
  command
      ->add_option_function<std::string>(
          "--size",
          [&request](const std::string& text) {
            const ImageSize size = image_size_from("--size", text);
            request.camera.width = size.width;
            request.camera.height = size.height;
          },
          "Size of the pictures (default: the calibration's)")
      ->type_name("WIDTHxHEIGHT");
  command->add_flag("--scale-calibration", request.camera.scale_calibration,
                    "For a size other than the calibration's: scale it, where a whole number of "
                    "pixels becomes one. Exact if both sizes show the same view");
  command->add_option("--fps", request.camera.fps, "Rate to ask the camera for (default: 30)")
      ->check(CLI::Range(0.1, 1000.0))
      ->type_name("RATE");
  command
      ->add_option("--format", request.camera.format,
                   "Pixel format (default: the one that costs least at that size and rate)")
      ->check(CLI::IsMember({"grey", "nv12", "yu12", "yuyv", "mjpeg", "rgb"}));
  CameraControls& controls = request.camera.controls;
  command
      ->add_option_function<std::string>(
          "--exposure",
          automatic_or_number("--exposure", controls.auto_exposure,
                              [&controls](double ms) { controls.exposure_ms = ms; }),
          "Exposure time [ms], or auto (default: as the camera is)")
      ->type_name("MS|auto");
  command->add_option("--gain", controls.gain, "Gain, in the camera's steps (libcamera: times)")
      ->check(plain_number)
      ->type_name("N");
  command
      ->add_option_function<std::string>(
          "--white-balance",
          automatic_or_number(
              "--white-balance", controls.auto_white_balance,
              [&controls](double k) { controls.white_balance_k = static_cast<int>(k); }),
          "White balance [K], or auto (default: as the camera is)")
      ->type_name("K|auto");
  command
      ->add_option("--focus", controls.focus,
                   "Focus, in the camera's steps (libcamera: dioptres); it is locked in any case, "
                   "where it can be")
      ->check(plain_number)
      ->type_name("N");
  command
      ->add_option("--record", request.record,
                   "Store what the camera gives, as a recording that replay opens")
      ->type_name("FOLDER");
  command
      ->add_option("--duration", request.duration_s,
                   "End after so many seconds from the first frame; where none comes, after as "
                   "many, but not before 10")
      ->check(CLI::Range(0.001, 1e9))
      ->type_name("SECONDS");
  add_scene_option(*command, options->run);
  command
      ->add_option("--tags", options->tags,
                   "What lies on the table (default: tags.yaml of the recording that is played, or "
                   "beside the calibration); penumbra target writes one with the sheet")
      ->type_name("FILE.yaml");
  add_shadow_options(*command, options->run.shadow);
  add_tracking_options(*command, request.tracking);
  add_smooth_option(*command, request.smooth);
  add_output_options(*command, request);
  add_frame_options(*command, request, options->run,
                    "the next frame is tracked while one is drawn");
  add_window_options(*command, options->run);
  command->add_flag("--no-vsync", options->no_vsync,
                    "Show frames at once: less latency, perhaps torn");
  command->add_flag("--no-dma-buf", options->no_dma_buf,
                    "Copy a camera's pictures to the GPU, also where it could read them where they "
                    "lie; the results are the same");
  command->footer(
      "In the window: F1 lists the keys, space pauses, Esc or q closes. Ctrl-C ends cleanly.\n\n"
      "Example:\n"
      "  penumbra live --calibration camera.yaml --tags tags.yaml --record session");
  command->callback([command, options, &chosen] {
    claim_outputs(*command, {"--poses", "--report"});
    if (played_recording(options->request.camera.source)) {
      for (const char* option : {"--size", "--format", "--exposure", "--gain", "--white-balance",
                                 "--focus", "--no-dma-buf"}) {
        if (command->count(option) == 0) continue;
        throw CLI::ValidationError(option, "a recording that plays as a camera has its own");
      }
    }
    warn_of_no_use(options->run.shadow);
    warn_of_no_use(*command, options->request.tracking);
    apply(options->run.shadow, options->request.plan);  // wrong usage ends here
    chosen = [options] { return live(*options); };
  });
}

}  // namespace penumbra
