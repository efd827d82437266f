// penumbra live: augments a camera's video in a window; writes video, poses, report, recording.

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "app/commands/configuration.hpp"
#include "app/commands/options.hpp"
#include "app/live/live_run.hpp"
#include "app/logging.hpp"
#include "app/run/session_host.hpp"
#include "app/window/kiosk_lock.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

struct LiveOptions {
  LiveRequest request;
  ShadowChoice shadow;
  std::optional<std::filesystem::path> tags;
};

// Returns the calibration of the recording that is played as a camera; empty if there is none.
std::filesystem::path recorded_calibration(const std::string& camera) {
  const auto played = played_recording(camera);
  std::error_code ignored;
  if (!played || !std::filesystem::exists(*played / "camera.yaml", ignored)) return {};
  return *played / "camera.yaml";
}

// Returns true if the session writes any file or stream.
bool writes(const LiveRequest& request) {
  return request.output || request.poses || request.group_poses || request.frame_log ||
         request.report || request.refined_map || request.saved_scene || request.record;
}

// Calibrates the session's camera with the session's tags, at the size of the session.
Result<bool> calibrate(const LiveRequest& request, const RunReport& report,
                       const std::filesystem::path& file) {
  CameraRequest camera = request.camera;
  if (!played_recording(camera.source)) {
    camera.width = report.width;
    camera.height = report.height;
  }
  return calibrate_camera(camera, {request.tags, file, {}});
}

Result<ExitCode> live(const LiveOptions& options) {
  LiveRequest request = options.request;
  PENUMBRA_TRY_VOID(complete(request));
  if (request.camera.fov_deg) {
    fmt::print("calibration: none; poses stay uncertain ({:g} degrees are assumed)\n",
               *request.camera.fov_deg);
    if (request.poses && !request.poses_all)
      log_warning("--poses: no pose is tracked without a calibration; add --poses-all");
  } else if (request.camera.calibration.empty()) {
    request.camera.calibration = recorded_calibration(request.camera.source);
    fmt::print("calibration: {}\n", request.camera.calibration.string());
  }
  PENUMBRA_TRY(request.tags, tags_for_camera(options.tags, request.camera));
  request.camera.recorded = request.record.has_value();

  while (true) {
    PENUMBRA_TRY(const auto report, run_live(request));
    fmt::print("{}", report_table(report));
    if (report.failure) return tl::unexpected(*report.failure);
    fmt::print("{}", written_files(request, request.record));
    if (!report.calibrates || report.interrupted) return ExitCode::success;
    const std::filesystem::path file = free_name("camera", ".yaml");
    PENUMBRA_TRY(const bool goes_on, calibrate(request, report, file));
    if (!goes_on) return ExitCode::success;
    // Another session would replace the files of this one.
    if (writes(request)) {
      fmt::print("to go on: penumbra live --camera {} --calibration {} --tags {}\n",
                 request.camera.source, file.string(), request.tags.string());
      return ExitCode::success;
    }
    request.camera.calibration = file;
    request.camera.camera_name.clear();
    request.camera.scale_calibration = false;
    request.camera.fov_deg.reset();
  }
}

// Adds an option whose value is "auto" or a number, which is passed to `set`.
template <class Set>
void add_automatic_option(CLI::App& command, const std::string& name, const std::string& type,
                          bool& automatic, Set set, const std::string& description) {
  const auto parse = [name, &automatic, set](const std::string& text) {
    automatic = text == "auto";
    if (automatic) return;
    const auto number = parse_number(text);
    if (!number || !(*number >= 0.0 && *number <= 1e6)) {
      usage_error(name, "{}: is neither auto nor a number", text);
    }
    set(*number);
  };
  add_text_option(command, name, type, parse, description);
}

std::string check_control(const std::string& text) {
  constexpr double kMaxSteps = 1e6;
  const auto number = parse_number(text);
  if (!number) return fmt::format("{}: is not a number", text);
  if (!(std::abs(*number) <= kMaxSteps)) {
    return fmt::format("{}: is out of range; no camera has more than {:.0f} steps", text,
                       kMaxSteps);
  }
  return {};
}

// Adds --fov, whose value may be omitted.
void add_fov_option(CLI::App& command, std::optional<double>& fov_deg) {
  static constexpr double kWebcam_deg = 60.0;
  const auto set = [&fov_deg](const std::string& text) {
    const auto given = text.empty() ? std::optional(kWebcam_deg) : parse_number(text);
    if (!given || !(*given >= 10.0 && *given <= 150.0))
      usage_error("--fov", "{}: give degrees from 10 to 150", text);
    fov_deg = *given;
  };
  CLI::Option* option = add_text_option(
      command, "--fov", "[DEGREES]", set,
      "Start without a calibration: horizontal field of view (60); poses stay uncertain");
  option->expected(0, 1);
  for (const char* other : {"--calibration", "--camera-name", "--scale-calibration"})
    option->excludes(command.get_option(other));
}

void add_camera_options(CLI::App& command, CameraRequest& camera) {
  add_option(command, "--camera", "CAMERA", camera.source,
             "v4l2:DEVICE, libcamera:NUMBER, libcamera:NAME, or recording:FOLDER")
      ->capture_default_str();
  add_option(command, "--calibration", "camera.yaml", camera.calibration,
             "Camera file of penumbra calibrate (recording:FOLDER: default FOLDER/camera.yaml)");
  start_group(command, "Camera");
  add_camera_name_option(command, camera.camera_name);
  add_size_option(command, "WIDTHxHEIGHT", camera.width, camera.height,
                  "Size of the images (default: the calibration's)");
  command.add_flag("--scale-calibration", camera.scale_calibration,
                   "Scale the calibration by a whole number; --size must show the same view");
  add_fov_option(command, camera.fov_deg);
  add_fps_option(command, camera.fps);
  add_text_option(
      command, "--format", "FORMAT",
      [&camera](const std::string& format) { camera.format = format; },
      "grey, nv12, yu12, yuyv, mjpeg or rgb (default: the cheapest at that size and rate)")
      ->check(CLI::IsMember({"grey", "nv12", "yu12", "yuyv", "mjpeg", "rgb"}).description(""));
  CameraControls& controls = camera.controls;
  add_automatic_option(
      command, "--exposure", "MS|auto", controls.auto_exposure,
      [&controls](double ms) { controls.exposure_ms = ms; },
      "Exposure time [ms], or auto (default: as the camera is)");
  add_option(command, "--gain", "N", controls.gain,
             "Gain, in the camera's steps (libcamera: times)")
      ->check(check_control);
  add_automatic_option(
      command, "--white-balance", "K|auto", controls.auto_white_balance,
      [&controls](double k) { controls.white_balance_k = static_cast<int>(k); },
      "White balance [K], or auto (default: as the camera is)");
  add_option(command, "--focus", "N", controls.focus,
             "Focus, in the camera's steps (libcamera: dioptres); autofocus is off in any case")
      ->check(check_control);
  add_off_flag(command, "--no-dma-buf", camera.dma_buf,
               "Always copy images to the GPU; the results are the same");
}

void add_kiosk_options(CLI::App& command, ViewerOptions& viewer) {
  start_group(command, "Kiosk and configuration");
  CLI::Option* kiosk =
      command
          .add_flag("--kiosk", viewer.kiosk,
                    fmt::format("Full screen, keys and panels locked ({} unlocks); waits for the "
                                "camera",
                                kUnlockKeys))
          ->excludes(command.get_option("--no-window"));
  add_option(command, "--reset-after", "SECONDS", viewer.reset_after_s,
             "With --kiosk: put everything back after this time without a touch; 0: never")
      ->check(in_range(0.0, 1e6))
      ->needs(kiosk)
      ->capture_default_str();
  // load_configuration() has read the file before the command line is parsed.
  add_text_option(
      command, "--config", "FILE.yaml", [](const std::string&) {},
      "Further options by their names (default: penumbra/config.yaml in ~/.config)");
}

}  // namespace

void add_live_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "live", "Augment what a camera sees: track, composite, show, record",
      "In the window: F1 lists the keys, space pauses, Esc or q closes. Ctrl-C ends cleanly.\n\n"
      "Example:\n"
      "  penumbra live --calibration camera.yaml --tags tags.yaml --record session");
  const auto options = std::make_shared<LiveOptions>();
  LiveRequest& request = options->request;
  add_camera_options(command, request.camera);
  add_option(command, "--record", "FOLDER", request.record,
             "Record the camera's frames, as a recording that replay opens");
  add_option(command, "--duration", "SECONDS", request.duration_s,
             "End this many seconds after the first frame")
      ->check(in_range(0.001, 1e9));
  add_scene_option(command, request);
  add_object_option(command, request.objects);
  add_option(command, "--tags", "FILE.yaml", options->tags,
             "Tag map (default: tags.yaml of the recording that is played, or beside the "
             "calibration)");
  add_shadow_options(command, options->shadow);
  add_tracking_options(command, request.tracking);
  add_refine_map_option(command, request);
  add_smooth_option(command, request.smooth);
  add_output_options(command, request);
  add_frame_options(command, request, options->shadow);
  add_window_options(command, request);
  add_off_flag(
      command, "--no-vsync", request.vsync,
      "Show frames without waiting for the display's refresh: less latency, possible tearing");
  add_kiosk_options(command, request.viewer);
  put_first(command, {"--record", "--scene", "--tags", "--shadow", "--tracking", "--output",
                      "--poses", "--report"});
  command.callback([&command, options, &chosen] {
    claim_outputs(command, {"--poses", "--frame-log", "--report", "--refine-map", "--refine-camera",
                            "--save-scene"});
    const CameraRequest& camera = options->request.camera;
    check_camera_source(camera.source);
    if (camera.calibration.empty() && !camera.fov_deg &&
        recorded_calibration(camera.source).empty()) {
      const auto played = played_recording(camera.source);
      if (std::error_code ignored; played && !std::filesystem::exists(*played, ignored)) {
        chosen = [played]() -> Result<ExitCode> {
          return fail("{}: no such recording or video file; correct --camera", played->string());
        };
        return;
      }
      usage_error(
          "--calibration",
          "{}; or let penumbra setup make it; or start with --fov, and press V to calibrate",
          kCalibrationMissing);
    }
    if (camera.fov_deg && (options->request.refined_camera || options->request.refine_map))
      usage_error("--fov", "a guessed lens can't be refined; remove --refine-map, --refine-camera");
    if (played_recording(camera.source)) {
      for (const char* option : {"--size", "--format", "--exposure", "--gain", "--white-balance",
                                 "--focus", "--no-dma-buf"}) {
        if (command.count(option) == 0) continue;
        usage_error(option,
                    "a recording that plays as a camera has fixed values; remove the option");
      }
    }
    set_run_options(command, options->shadow, options->request);
    options->request.configuration = command.count("--config") > 0
                                         ? command.get_option("--config")->as<std::string>()
                                         : configuration_file();
    for (const char* name : kept_options()) {
      const CLI::Option* option = command.get_option_no_throw(name);
      if (option == nullptr || option->count() == 0) continue;
      options->request.kept_options.emplace_back(name, option->results().back());
    }
    chosen = [options] { return live(*options); };
  });
}

}  // namespace penumbra
