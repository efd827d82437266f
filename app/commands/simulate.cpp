// penumbra simulate SCENE: renders a synthetic recording with exact ground truth.

#include <algorithm>
#include <memory>
#include <thread>

#include "app/commands/options.hpp"
#include "app/recording/simulate_run.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

Result<ExitCode> simulate(const SimulateRequest& request) {
  PENUMBRA_TRY(const auto summary, run_simulate(request));
  fmt::print("frames: {}\nrecording: {}\n", summary.frames, request.output.string());
  return ExitCode::success;
}

// Adds the groups given as NAME=FILE.tum to the request.
void add_groups(const std::vector<std::string>& given, SimulateRequest& request) {
  for (const std::string& text : given) {
    const std::size_t equals = text.rfind('=');
    if (equals == 0 || equals == std::string::npos || equals + 1 == text.size()) {
      usage_error("--group", "{}: is not of the form NAME=FILE.tum", text);
    }
    const std::string name = text.substr(0, equals);
    if (!request.groups.emplace(name, text.substr(equals + 1)).second) {
      usage_error("--group", "{}: is given twice", name);
    }
  }
}

}  // namespace

void add_simulate_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "simulate",
      "Make a synthetic recording with exact truth: tags, lens, motion blur, noise",
      "The recording holds frames/*.png, timestamps.csv, camera.yaml, tags.yaml and "
      "groundtruth.tum (groups/NAME.tum for groups of tags beside the table), and opens in every "
      "command that takes one. "
      "Ctrl-C ends early; the recording holds the frames up to then.\n\n"
      "Example:\n"
      "  penumbra simulate board --camera recordings/tabletop/camera.yaml \\\n"
      "    --tags recordings/tabletop/tags.yaml --trajectory recordings/tabletop/groundtruth.tum "
      "\\\n"
      "    --output synthetic --noise 2 --blur 0.01 --seed 7\n"
      "  penumbra replay synthetic --report report.json\n"
      "  penumbra simulate board --camera camera.yaml --tags tags.yaml --trajectory hand.tum "
      "\\\n    --group prop=prop.tum --output synthetic");
  const auto request = std::make_shared<SimulateRequest>();
  request->threads = static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1U, 16U));
  const auto set_scene = [request](const std::string& scene) {
    if (scene != "board") request->scene = scene;
  };
  add_text_option(command, "SCENE", "FILE.json|board", set_scene,
                  "Scene drawn over the tags, or `board`: tags alone")
      ->required();
  add_option(command, "--camera", "camera.yaml", request->camera, "The camera and its lens")
      ->required();
  add_camera_name_option(command, request->camera_name);
  add_option(command, "--tags", "tags.yaml", request->tags, "Tag map")->required();
  add_option(command, "--trajectory", "FILE.tum", request->trajectory,
             "Camera poses, one per frame, at the middle of its exposure")
      ->required();
  command
      .add_option_function<std::vector<std::string>>(
          "--group",
          [request](const std::vector<std::string>& given) { add_groups(given, *request); },
          "Motion of the group NAME: T_table_group over the same time")
      ->type_name("NAME=FILE.tum");
  add_option(command, "--output", "DIR", request->output, "The recording: a new or empty folder")
      ->required();
  add_option(command, "--noise", "SIGMA", request->noise_grey,
             "Sigma of white noise, after the camera response [grey levels]")
      ->check(in_range(0.0, 255.0))
      ->capture_default_str();
  add_option(command, "--blur", "SECONDS", request->exposure_s,
             "Exposure time: the camera moves on a smooth curve through the poses [s]")
      ->check(in_range(0.0, 10.0))
      ->capture_default_str();
  start_group(command, "Image");
  add_option(command, "--seed", "N", request->seed,
             "Seed of the noise: the same seed gives the same bytes")
      ->check(whole_number())
      ->capture_default_str();
  add_option(command, "--tone", "EXPONENT", request->tone_curve,
             "Camera response: light = value ^ exponent (default: the camera file's, or 1)")
      ->check(in_range(0.2, 5.0));
  add_option(command, "--gain", "FACTOR", request->gain, "Brightness: multiplies the light")
      ->check(in_range(0.001, 1000.0))
      ->capture_default_str();
  add_option(command, "--lens-blur", "PX", request->lens_blur_px,
             "Sigma of the lens's own blur [px]")
      ->check(in_range(0.0, 10.0))
      ->capture_default_str();
  CLI::Option* cover = add_option(command, "--cover", "FRACTION", request->covered_fraction,
                                  "Part of every tag covered by grey, from its left side")
                           ->check(in_range(0.0, 1.0))
                           ->capture_default_str();
  add_option(command, "--cover-from", "FRAME", request->cover_from,
             "First frame of --cover; before it tags are uncovered")
      ->check(whole_number())
      ->needs(cover)
      ->capture_default_str();
  command.callback([request, &chosen] { chosen = [request] { return simulate(*request); }; });
}

}  // namespace penumbra
