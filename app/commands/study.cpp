// penumbra study: runs the two experiments of Layered Penumbrae with a person or a script. Writes
// the answers to a CSV file and prints a summary.

#include <algorithm>
#include <memory>
#include <ranges>

#include "app/commands/options.hpp"
#include "app/resources.hpp"
#include "app/study/study_run.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

struct StudyOptions {
  StudyRequest request;
  std::optional<int> samples;
  std::string techniques = "layered,walls";  // the techniques that the paper compares
  double tolerance_mm = 10.0;
  bool plan = false;
};

std::vector<StudyTechnique> techniques_from(const std::string& list) {
  std::vector<StudyTechnique> techniques;
  for (const auto part : std::views::split(list, ',')) {
    const std::string name(part.begin(), part.end());
    auto technique = study_technique_from_string(name);
    if (!technique) {
      usage_error("--techniques", "{}: no such technique; known: {}", name, known_techniques());
    }
    if (std::ranges::count(techniques, name, &StudyTechnique::name) > 0) {
      usage_error("--techniques", "{}: is named twice", name);
    }
    techniques.push_back(std::move(*technique));
  }
  return techniques;
}

void print_plan(const StudyDesign& design) {
  const StudyPlan plan = plan_study(design);
  fmt::print("number,block,trial,technique,sample,difficulty,places_m\n");
  for (const StudyTrial& trial : plan.trials) {
    const StudySample& sample = plan.samples[static_cast<std::size_t>(trial.sample)];
    const bool heights = design.experiment == StudyExperiment::heights;
    fmt::print("{},{},{},{},{},{},{}\n", trial.number, trial.block, trial.trial,
               design.techniques[static_cast<std::size_t>(trial.technique)].name, sample.number,
               difficulty_of(heights, sample.hard), format_places(sample.places));
  }
}

// Fails if a file or folder that the command line names is missing.
Result<void> check_inputs_exist(const StudyRequest& request) {
  std::vector<std::filesystem::path> named = {request.recording, request.camera.calibration,
                                              request.tags.value_or(""),
                                              request.script.value_or("")};
  if (request.poses_from && *request.poses_from != "groundtruth")
    named.emplace_back(*request.poses_from);
  std::error_code ignored;
  for (const auto& path : named) {
    if (!path.empty() && !std::filesystem::exists(path, ignored))
      return fail("{}: there is no such file or folder; check the path", path.string());
  }
  return {};
}

Result<ExitCode> study(const StudyOptions& options) {
  StudyRequest request = options.request;
  if (options.plan) {
    PENUMBRA_TRY_VOID(check_inputs_exist(request));
    print_plan(request.design);
    return ExitCode::success;
  }
  if (request.from_camera) {
    PENUMBRA_TRY(request.tags, tags_for_camera(request.tags, request.camera));
  } else if (request.recording.empty()) {
    PENUMBRA_TRY(request.recording, find_bundled_recording("tabletop"));
  }
  PENUMBRA_TRY(const auto report, run_study(request));
  fmt::print("{}\nanswers: {}\n", summary_table(request.design.experiment, report.summary),
             request.results.string());
  if (!report.summary_file.empty()) fmt::print("summary: {}\n", report.summary_file.string());
  if (report.answered < report.trials) {
    fmt::print("participant {} has answered {} of {} trials; --resume goes on there\n",
               request.design.participant, report.answered, report.trials);
  }
  return ExitCode::success;
}

void add_design_options(CLI::App& command, StudyOptions& options) {
  StudyDesign& design = options.request.design;
  const auto set_experiment = [&design](const std::string& name) {
    if (name != "heights" && name != "drag") {
      usage_error("--experiment", "{}: is neither heights nor drag", name);
    }
    design.experiment = name == "heights" ? StudyExperiment::heights : StudyExperiment::drag;
  };
  add_text_option(command, "--experiment", "heights|drag", set_experiment,
                  "heights: point at the highest of three spheres; drag: move a sphere to targets")
      ->required();
  add_option(command, "--output", "FILE.csv", options.request.results,
             "Answers; those of further participants are added; - is standard output");
  add_option(command, "--techniques", "A,B,...", options.techniques,
             "One block of trials each: " + known_techniques())
      ->capture_default_str();
  add_option(command, "--participant", "N", design.participant,
             "Number of the participant: chooses the order of techniques and samples")
      ->check(in_range(1, 1'000'000))
      ->capture_default_str();
  start_group(command, "Experiment");
  add_option(command, "--seed", "N", design.seed,
             "Seed of the random samples; the same for all participants of a study")
      ->check(whole_number())
      ->capture_default_str();
  add_option(command, "--trials", "N", options.samples,
             "Samples for each technique (default as in the paper, heights: 20, drag: 5)")
      ->check(in_range(1, kMaxStudySamples));
  add_option(command, "--tolerance", "MM", options.tolerance_mm,
             "Maximum distance between a released sphere and its target [mm]")
      ->check(in_range(0.1, 100.0))
      ->capture_default_str();
  add_option(command, "--pause", "SECONDS", options.request.pause_s,
             "Time without spheres between two trials [s]")
      ->check(in_range(0.0, 3600.0))
      ->capture_default_str();
}

}  // namespace

void add_study_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "study",
      "Measure how well people see heights by a shadow: point at the highest of three spheres, or "
      "drag a sphere onto targets",
      "In the window: space or a click begins a block, F11 is full screen, Esc ends; answers so "
      "far are kept.\n\n"
      "Example:\n"
      "  penumbra study --experiment heights --techniques layered,walls --participant 1 "
      "\\\n    --output heights.csv");
  const auto options = std::make_shared<StudyOptions>();
  StudyRequest& request = options->request;
  add_design_options(command, *options);
  command.add_flag("--resume", request.resume,
                   "Go on with an interrupted participant, at the first trial without an answer");
  start_group(command, "Input");
  CLI::Option* recording =
      add_option(command, "--recording", "FOLDER", request.recording,
                 "Images to work on, from the first at every trial (default: bundled)");
  add_poses_from_option(command, request.poses_from);
  CLI::Option* camera = add_option(command, "--camera", "CAMERA", request.camera.source,
                                   "Work on the images of a camera, as in penumbra live")
                            ->excludes(recording);
  CLI::Option* calibration =
      add_option(command, "--calibration", "camera.yaml", request.camera.calibration,
                 "The camera's model (default: the recording's)");
  add_camera_name_option(command, request.camera.camera_name)->needs(calibration);
  add_fps_option(command, request.camera.fps)->needs(camera);
  add_option(command, "--tags", "FILE.yaml", request.tags,
             "Tag map (default: the recording's, or as in penumbra live)");
  add_tracking_options(command, request.tracking);
  start_group(command, "Experiment");
  add_option(command, "--script", "FILE", request.script,
             "A scripted participant answers: lines of trial, seconds, action: 1 1.25 click sphere "
             "2");
  command.add_flag("--plan", options->plan,
                   "Print the participant's trials as CSV, and do nothing else");
  add_off_flag(command, "--no-window", request.window,
               "A scripted participant works offscreen, even if there is a display");
  put_first(command, {"--resume", "--recording", "--camera", "--calibration", "--tags", "--plan"});
  command.callback([&command, camera, options, &chosen] {
    claim_outputs(command, {"--output"});
    StudyRequest& chosen_request = options->request;
    StudyDesign& design = chosen_request.design;
    design.techniques = techniques_from(options->techniques);
    design.samples = options->samples.value_or(default_samples(design.experiment));
    design.tolerance_m = 1e-3 * options->tolerance_mm;
    chosen_request.from_camera = camera->count() > 0;
    if (!options->plan && chosen_request.results.empty()) {
      usage_error("--output", "is missing; name the file for the answers");
    }
    if (chosen_request.from_camera) {
      check_camera_source(chosen_request.camera.source);
      if (chosen_request.camera.calibration.empty())
        usage_error("--calibration", kCalibrationMissing);
    }
    if (command.count("--calibration") > 0 && !chosen_request.from_camera &&
        command.count("--recording") == 0) {
      usage_error("--calibration", "is for --camera or --recording; name one of them");
    }
    if (chosen_request.from_camera && chosen_request.poses_from) {
      usage_error("--poses-from", "is for recordings; a camera is tracked");
    }
    if (design.experiment != StudyExperiment::drag && command.count("--tolerance") > 0) {
      usage_error("--tolerance", "applies to --experiment drag only");
    }
    warn_of_unused_options(command, chosen_request.tracking);
    chosen = [options] { return study(*options); };
  });
}

}  // namespace penumbra
