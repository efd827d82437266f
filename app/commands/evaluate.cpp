// penumbra evaluate: how far an estimated camera path is from the true one.

#include "core/evaluation.hpp"

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <memory>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/run_report.hpp"
#include "core/camera_file.hpp"
#include "core/trajectory.hpp"

namespace penumbra {
namespace {

struct EvaluateOptions {
  std::filesystem::path estimated;
  std::filesystem::path groundtruth;
  std::filesystem::path camera;
  bool json = false;
};

Result<ExitCode> run_evaluate(const EvaluateOptions& options) {
  const auto camera = load_camera(options.camera);
  if (!camera) return tl::unexpected(camera.error());
  const auto estimated = load_trajectory(options.estimated);
  if (!estimated) return tl::unexpected(estimated.error());
  const auto truth = load_trajectory(options.groundtruth);
  if (!truth) return tl::unexpected(truth.error());
  const Evaluation evaluation = evaluate(*camera, *estimated, *truth);
  if (evaluation.frames_with_pose == 0) {
    return fail(
        "{}: has no pose within 1 ms of one in {}; are both of the same recording, with times in "
        "seconds?",
        options.estimated.string(), options.groundtruth.string());
  }
  fmt::print("{}", options.json ? evaluation_json(evaluation) : evaluation_table(evaluation));
  return ExitCode::success;
}

}  // namespace

void add_evaluate_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command = program.add_subcommand(
      "evaluate", "Compare an estimated camera path with the true one, in the table frame");
  add_common_options(*command);
  const auto options = std::make_shared<EvaluateOptions>();
  command->add_option("--estimated", options->estimated, "Estimated camera poses")
      ->required()
      ->type_name("FILE.tum");
  command->add_option("--groundtruth", options->groundtruth, "True camera poses")
      ->required()
      ->type_name("FILE.tum");
  command
      ->add_option("--camera", options->camera, "Camera model: what the overlay error is seen by")
      ->required()
      ->type_name("camera.yaml");
  command->add_flag("--json", options->json, "JSON instead of a table");
  command->footer(
      "No alignment: the table frame is known. Overlay error: how far the corners of a 0.2 m cube "
      "on the\ntable's origin are from where the true pose shows them.\n\n"
      "Example:\n"
      "  penumbra evaluate --estimated out.tum --groundtruth recordings/tabletop/groundtruth.tum "
      "--camera recordings/tabletop/camera.yaml");
  command->callback([options, &chosen] { chosen = [options] { return run_evaluate(*options); }; });
}

}  // namespace penumbra
