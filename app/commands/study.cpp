// penumbra study: the two experiments of Layered Penumbrae with a person, or a script -> a CSV file
// of answers and what they come to.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/resources.hpp"
#include "app/study/study_run.hpp"
#include "app/tags_in_use.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

struct StudyOptions {
  StudyRequest request;
  std::optional<int> samples;
  std::optional<std::string> camera;
  std::optional<std::filesystem::path> calibration, results;
  std::string techniques = "layered,walls";  // as the paper compared them
  double tolerance_mm = 10.0;
  bool plan = false, no_window = false;
};

std::vector<StudyTechnique> techniques_from(const std::string& list) {
  std::vector<StudyTechnique> techniques;
  std::size_t start = 0;
  while (start <= list.size()) {
    const std::size_t end = std::min(list.find(',', start), list.size());
    const std::string name = list.substr(start, end - start);
    start = end + 1;
    auto technique = study_technique_from_string(name);
    if (!technique) {
      throw CLI::ValidationError("--techniques", fmt::format("{}: no such technique; known: {}",
                                                             name, known_techniques()));
    }
    if (std::ranges::find(techniques, name, &StudyTechnique::name) != techniques.end()) {
      throw CLI::ValidationError("--techniques", fmt::format("{}: is named twice", name));
    }
    techniques.push_back(std::move(*technique));
  }
  return techniques;
}

// What the participant would see, in the order of the trials.
void print_plan(const StudyDesign& design) {
  const StudyPlan plan = plan_study(design);
  fmt::print("number,block,trial,technique,sample,difficulty,places_m\n");
  for (const StudyTrial& trial : plan.trials) {
    const StudySample& sample = plan.samples[static_cast<std::size_t>(trial.sample)];
    std::string places;
    for (const Eigen::Vector3d& p : sample.places) {
      places +=
          fmt::format("{}{:.4f} {:.4f} {:.4f}", places.empty() ? "" : ";", p.x(), p.y(), p.z());
    }
    const bool heights = design.experiment == StudyExperiment::heights;
    fmt::print("{},{},{},{},{},{},{}\n", trial.number, trial.block, trial.trial,
               design.techniques[static_cast<std::size_t>(trial.technique)].name, sample.number,
               !heights      ? ""
               : sample.hard ? "hard"
                             : "easy",
               places);
  }
}

Result<ExitCode> study(const StudyOptions& options) {
  StudyRequest request = options.request;
  if (options.plan) {
    print_plan(request.design);
    return ExitCode::success;
  }
  request.results = *options.results;
  request.window = !options.no_window;
  if (options.camera) {
    request.camera.source = *options.camera;
    if (!options.calibration) {
      return fail(
          "--calibration: is missing; name the camera's camera.yaml, which penumbra calibrate "
          "makes");
    }
    request.camera.calibration = *options.calibration;
  }
  if (options.camera) {
    PENUMBRA_TRY(auto tags,
                 tags_for_camera(request.tags, *options.camera, request.camera.calibration));
    request.camera_tags = std::move(tags);
  } else if (!request.recording) {
    PENUMBRA_TRY(const auto resources, find_resources());
    request.recording = resources / "recordings" / "tabletop";
  }
  const auto report = run_study(request);
  if (!report) return tl::unexpected(report.error());
  fmt::print("{}\nanswers: {}\n", summary_table(request.design.experiment, report->summary),
             request.results.string());
  if (!report->summary_file.empty()) fmt::print("summary: {}\n", report->summary_file.string());
  if (report->answered < report->trials) {
    fmt::print("participant {} has answered {} of {} trials; --resume goes on there\n",
               request.design.participant, report->answered, report->trials);
  }
  return ExitCode::success;
}

}  // namespace

void add_study_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command = program.add_subcommand(
      "study",
      "How well people see heights by a shadow: point at the highest of three spheres, or drag a "
      "sphere onto targets");
  add_common_options(*command);
  const auto options = std::make_shared<StudyOptions>();
  StudyRequest& request = options->request;
  StudyDesign& design = request.design;

  command
      ->add_option_function<std::string>(
          "--experiment",
          [&design](const std::string& name) {
            if (name != "heights" && name != "drag") {
              throw CLI::ValidationError("--experiment",
                                         fmt::format("{}: is neither heights nor drag", name));
            }
            design.experiment =
                name == "heights" ? StudyExperiment::heights : StudyExperiment::drag;
          },
          "heights: point at the highest of three spheres; drag: bring a sphere onto three to five "
          "targets in turn")
      ->required()
      ->type_name("heights|drag");
  command
      ->add_option("--output", options->results,
                   "Answers; those of further participants are added to the same file. The summary "
                   "is written beside it (NAME-summary.csv); - is standard output")
      ->type_name("FILE.csv");
  command
      ->add_option("--techniques", options->techniques,
                   fmt::format("Shadow techniques to compare, each a block of trials: {}",
                               known_techniques()))
      ->capture_default_str()
      ->type_name("A,B,...");
  command
      ->add_option("--participant", design.participant,
                   "The participant's number: it chooses the order of techniques and samples from "
                   "balanced designs, so number them 1, 2, 3, ...")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str()
      ->type_name("N");
  command
      ->add_option("--seed", design.seed,
                   "What the samples are drawn from; the same for all participants of a study")
      ->capture_default_str()
      ->type_name("N");
  command
      ->add_option("--trials", options->samples,
                   "Samples for each technique (default: as in the paper, 20 for heights, 5 for "
                   "drag)")
      ->check(CLI::Range(1, kMostStudySamples))
      ->type_name("N");
  command
      ->add_option("--tolerance", options->tolerance_mm,
                   "How near a sphere that is let go must be to its target [mm]")
      ->check(CLI::Range(0.1, 100.0))
      ->capture_default_str()
      ->type_name("MM");
  command->add_option("--pause", request.pause_s, "Time without spheres between two trials [s]")
      ->check(CLI::Range(0.0, 3600.0))
      ->capture_default_str()
      ->type_name("SECONDS");
  command->add_flag("--resume", request.resume,
                    "Go on with a participant who was interrupted, at the first trial that has no "
                    "answer");
  CLI::Option* recording =
      command
          ->add_option("--recording", request.recording,
                       "Pictures to work on, from the first at every trial (default: the bundled "
                       "recording)")
          ->type_name("FOLDER");
  command
      ->add_option("--poses-from", request.poses_from,
                   "Draw with given poses instead of tracking: groundtruth (the recording's), or a "
                   "TUM file")
      ->type_name("groundtruth|FILE.tum");
  CLI::Option* camera =
      command
          ->add_option("--camera", options->camera,
                       "Work on the live picture instead: v4l2:/dev/video0, libcamera:0 or "
                       "recording:FOLDER, as in penumbra live")
          ->type_name("CAMERA")
          ->excludes(recording);
  CLI::Option* calibration =
      command->add_option("--calibration", options->calibration, "The camera's model")
          ->needs(camera)
          ->type_name("camera.yaml");
  add_camera_name_option(*command, request.camera.camera_name)->needs(calibration);
  command->add_option("--fps", request.camera.fps, "Rate to ask the camera for (default: 30)")
      ->check(CLI::Range(0.1, 1000.0))
      ->needs(camera)
      ->type_name("RATE");
  command
      ->add_option("--tags", request.tags,
                   "What lies on the table (default: the recording's, or as in penumbra live)")
      ->type_name("FILE.yaml");
  add_tracking_options(*command, request.tracking);
  command
      ->add_option("--script", request.script,
                   "A scripted participant answers: lines of trial, seconds since it is shown, "
                   "and action, such as: 1 1.25 click sphere 2")
      ->type_name("FILE");
  command->add_flag("--plan", options->plan,
                    "Print the participant's trials as CSV, and do nothing else");
  command->add_flag("--no-window", options->no_window,
                    "A scripted participant works offscreen, also where there is a display");
  command->footer(
      "In the window: space or a click begins a block, F11 is full screen, Esc ends; answers so "
      "far are kept.\n\n"
      "Example:\n"
      "  penumbra study --experiment heights --techniques layered,walls --participant 1 --output "
      "heights.csv");
  command->callback([command, options, &chosen] {
    claim_outputs(*command, {"--output"});
    StudyDesign& chosen_design = options->request.design;
    chosen_design.techniques = techniques_from(options->techniques);
    chosen_design.samples = options->samples.value_or(usual_samples(chosen_design.experiment));
    chosen_design.tolerance_m = 1e-3 * options->tolerance_mm;
    if (!options->plan && !options->results) {
      throw CLI::ValidationError("--output", "is missing; name the file for the answers");
    }
    if (options->camera && options->request.poses_from) {
      throw CLI::ValidationError("--poses-from", "is for recordings; a camera is tracked");
    }
    if (chosen_design.experiment != StudyExperiment::drag && command->count("--tolerance") > 0) {
      throw CLI::ValidationError("--tolerance", "is of --experiment drag");
    }
    warn_of_no_use(*command, options->request.tracking);
    chosen = [options] { return study(*options); };
  });
}

}  // namespace penumbra
