// penumbra evaluate: compares an estimated camera trajectory with the ground truth, or the poses of
// two halves of the tags with each other.

#include "core/evaluation/evaluation.hpp"
#include "core/propagate.hpp"

#include <array>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "app/commands/options.hpp"
#include "app/logging.hpp"
#include "app/output/error_log.hpp"
#include "app/output/output_file.hpp"
#include "app/output/split_half_plot.hpp"
#include "app/recording/recording_source.hpp"
#include "app/replay/split_half_run.hpp"
#include "app/report/run_report.hpp"
#include "app/report/split_half_report.hpp"
#include "app/run_inputs.hpp"
#include "core/evaluation/pose_convention_hint.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

struct EvaluateOptions {
  std::filesystem::path estimated;
  std::filesystem::path groundtruth;
  std::filesystem::path camera;
  std::string camera_name;
  std::optional<std::filesystem::path> tags, estimated_groups, groundtruth_groups;
  PairingOptions pairing;
  std::optional<std::filesystem::path> json;  // "-": standard output
  std::filesystem::path split_half;           // recording; empty: compares with the ground truth
  std::optional<std::filesystem::path> plot;
  std::optional<std::filesystem::path> per_frame;
  TrackerOptions tracking;
};

// Prints the table, or writes the JSON to the file of --json.
Result<void> write_results(const EvaluateOptions& options, const std::string& table,
                           const std::string& json) {
  if (!options.json) {
    fmt::print("{}", table);
    return {};
  }
  if (names_standard_output(*options.json)) {
    fmt::print("{}", json);
    return {};
  }
  PENUMBRA_TRY(auto file, OutputFile::create(*options.json));
  PENUMBRA_TRY_VOID(write_text(file, json));
  fmt::print("{}", table);
  return {};
}

// Returns the time range of a trajectory, such as "0.000000000 to 3.966667000 s".
std::string times_of(const Trajectory& trajectory, std::int64_t offset_ns = 0) {
  const auto time_of = [&](const StampedPose& pose) {
    return format_ns_as_seconds(shifted(pose.timestamp_ns, offset_ns));
  };
  return fmt::format("{} to {} s", time_of(trajectory.poses.front()),
                     time_of(trajectory.poses.back()));
}

// Fails if no pose could be compared with the truth, or if the times are not in seconds.
Result<void> check_pairing(const Evaluation& evaluation, const NamedTrajectory& estimated,
                           const NamedTrajectory& truth, const PairingOptions& pairing) {
  for (const auto& [trajectory, name] : {estimated, truth}) {
    if (trajectory.poses.empty()) return fail("{}: holds no pose", name);
  }
  PENUMBRA_TRY(const auto warnings, check_units_of_time(estimated, truth, pairing));
  for (const std::string& warning : warnings) log_warning("{}", warning);
  if (evaluation.frames_judged > 0) return {};
  return fail(
      "{}: has no pose that can be compared with {}: {}; its times are {}{}, those of the ground "
      "truth {}. "
      "Are both of the same recording? --time-offset shifts the estimate, --max-gap allows longer "
      "gaps",
      estimated.name, truth.name, not_judged_text(evaluation),
      times_of(estimated.trajectory, pairing.time_offset_ns),
      pairing.time_offset_ns == 0
          ? ""
          : fmt::format(" with --time-offset {:g} added", seconds(pairing.time_offset_ns)),
      times_of(truth.trajectory));
}

// Evaluates the tag groups that have both a file of estimated poses and one of true poses.
Result<std::map<std::string, Evaluation>> evaluate_groups(const EvaluateOptions& options,
                                                          const CameraModel& camera,
                                                          const Trajectory& estimated,
                                                          const Trajectory& truth) {
  std::map<std::string, Evaluation> evaluations;
  if (!options.tags) return evaluations;
  PENUMBRA_TRY(const auto tags, load_tag_map(*options.tags));
  const std::vector<std::string> names = other_groups(tags);
  if (names.empty()) {
    return fail("{}: has no group of tags beside the table", options.tags->string());
  }
  for (const auto& folder : {*options.estimated_groups, *options.groundtruth_groups}) {
    std::error_code ignored;
    if (!std::filesystem::is_directory(folder, ignored)) {
      return fail("{}: is not a folder; give the one that holds NAME.tum of each group",
                  folder.string());
    }
  }
  PENUMBRA_TRY(const auto estimated_paths, load_group_paths(*options.estimated_groups, names));
  PENUMBRA_TRY(const auto true_paths, load_group_paths(*options.groundtruth_groups, names));
  for (const auto& [name, estimated_path] : estimated_paths) {
    const auto true_path = true_paths.find(name);
    if (true_path == true_paths.end()) continue;
    const auto T_group_middle = middle_of_group(tags, name);
    const auto file = *group_file(name);
    const std::string estimated_name = (*options.estimated_groups / file).string();
    const std::string true_name = (*options.groundtruth_groups / file).string();
    const Trajectory found_relative = relative_to_group(estimated, estimated_path, T_group_middle);
    const Trajectory true_relative =
        relative_to_group(truth, true_path->second, T_group_middle, options.pairing.max_gap_ns);
    if (found_relative.poses.empty() || true_relative.poses.empty()) {
      return fail(
          "{}: has no place at the time of any pose of {}",
          found_relative.poses.empty() ? estimated_name : true_name,
          (found_relative.poses.empty() ? options.estimated : options.groundtruth).string());
    }
    const Evaluation evaluation = evaluate(camera, found_relative, true_relative, options.pairing);
    PENUMBRA_TRY_VOID(check_pairing(evaluation, {found_relative, estimated_name},
                                    {true_relative, true_name}, options.pairing));
    evaluations.emplace(name, evaluation);
  }
  if (evaluations.empty()) {
    return fail("{}: has no file of a group that {} has one of too (NAME.tum for each group of {})",
                options.estimated_groups->string(), options.groundtruth_groups->string(),
                options.tags->string());
  }
  return evaluations;
}

Result<ExitCode> run_evaluate(const EvaluateOptions& options) {
  PENUMBRA_TRY(const auto camera, load_chosen_camera(options.camera, options.camera_name));
  PENUMBRA_TRY(const auto estimated, load_trajectory(options.estimated));
  PENUMBRA_TRY(const auto truth, load_trajectory(options.groundtruth));
  const std::string estimated_name = options.estimated.string();
  const std::string truth_name = options.groundtruth.string();
  const NamedTrajectory named_estimate{estimated, estimated_name};
  const NamedTrajectory named_truth{truth, truth_name};
  for (const NamedTrajectory& named : {named_estimate, named_truth}) {
    if (const int untracked = named.trajectory.untracked; untracked > 0) {
      log_warning("{}: {} of {} frames have no tracked pose; they are not compared", named.name,
                  untracked, named.trajectory.poses.size() + static_cast<std::size_t>(untracked));
    }
    if (!named.trajectory.of_body) continue;
    log_warning("{}: EuRoC's poses are of the body (the IMU); they are taken as the camera's",
                named.name);
  }
  const Evaluation evaluation = evaluate(camera, estimated, truth, options.pairing);
  PENUMBRA_TRY_VOID(check_pairing(evaluation, named_estimate, named_truth, options.pairing));
  if (const auto hint = pose_convention_hint(named_estimate, named_truth, options.pairing)) {
    log_warning("{}", *hint);
  }
  PENUMBRA_TRY(const auto groups, evaluate_groups(options, camera, estimated, truth));
  std::string table = evaluation_table(evaluation);
  for (const auto& [name, of_group] : groups) {
    table += fmt::format("\ntag group {}\n{}", name, evaluation_table(of_group));
  }
  if (options.per_frame)
    PENUMBRA_TRY_VOID(write_pose_errors(*options.per_frame, evaluation, groups));
  PENUMBRA_TRY_VOID(write_results(options, table, evaluation_json(evaluation, groups)));
  return ExitCode::success;
}

Result<ExitCode> run_evaluate_halves(const EvaluateOptions& options) {
  SplitHalfRequest request;
  request.recording = options.split_half;
  request.tags = options.tags;
  if (!options.camera.empty()) request.camera = options.camera;
  request.camera_name = options.camera_name;
  request.tracking = options.tracking;
  for (const auto& output : {options.json, options.plot, options.per_frame}) {
    if (output && !is_stream(*output) && lies_in(*output, options.split_half)) {
      return fail("{}: lies in the recording {}, which is only read; name a place outside it",
                  output->string(), options.split_half.string());
    }
  }
  std::optional<OutputFile> plot;
  if (options.plot) {
    PENUMBRA_TRY(plot, OutputFile::create(*options.plot));
  }
  std::optional<HalfErrorLog> per_frame;
  if (options.per_frame) {
    PENUMBRA_TRY(per_frame, HalfErrorLog::create(*options.per_frame));
    request.on_compared = [&log = *per_frame](const Frame& frame, std::size_t split,
                                              const HalfDifference& difference) {
      return log.add(frame, split, difference);
    };
  }
  const auto report = run_split_half(request);
  if (!report) {
    if (per_frame) per_frame->rescue();
    return tl::unexpected(report.error());
  }
  if (per_frame) PENUMBRA_TRY_VOID(per_frame->finish());
  PENUMBRA_TRY_VOID(write_results(options, split_half_table(*report), split_half_json(*report)));
  if (plot) {
    PENUMBRA_TRY_VOID(write_text(*plot, split_half_svg(*report)));
  }
  return ExitCode::success;
}

// Rejects options that the chosen comparison does not have, and requires the others.
void check_options(const CLI::App& command, const EvaluateOptions& options) {
  const bool halves = !options.split_half.empty();
  constexpr std::array kOfTruth = {"--estimated",          "--groundtruth", "--estimated-groups",
                                   "--groundtruth-groups", "--max-gap",     "--time-offset"};
  constexpr std::array kOfHalves = {"--plot", "--tracking", "--pose-budget",
                                    "--no-background-search"};
  if (halves) {
    if (options.plot && !is_stream(*options.plot) && lower_extension(*options.plot) != ".svg")
      usage_error("--plot", "{}: the plot is written as SVG; end the name in .svg",
                  options.plot->string());
    for (const char* option : kOfTruth) {
      if (command.count(option) > 0) usage_error(option, "is not used with --split-half");
    }
    return;
  }
  for (const char* option : kOfHalves) {
    if (command.count(option) > 0) usage_error(option, "needs --split-half RECORDING");
  }
  for (const char* option : {"--estimated", "--groundtruth", "--camera"}) {
    if (command.count(option) == 0)
      usage_error(option, "is required, unless --split-half RECORDING is given");
  }
  constexpr std::array kOfGroups = {"--tags", "--estimated-groups", "--groundtruth-groups"};
  for (const char* given : kOfGroups) {
    if (command.count(given) == 0) continue;
    for (const char* other : kOfGroups) {
      if (command.count(other) == 0) usage_error(given, "requires {}", other);
    }
  }
}

// Rejects outputs that would replace each other or an input, or share standard output.
void check_outputs(const CLI::App& command, const EvaluateOptions& options) {
  claim_outputs(command, {"--per-frame", "--plot"});
  const std::array inputs = {options.camera, options.tags.value_or(""), options.estimated,
                             options.groundtruth};
  std::vector<std::filesystem::path> outputs;
  for (const auto& [name, file] :
       {std::pair("--json", options.json), std::pair("--plot", options.plot),
        std::pair("--per-frame", options.per_frame)}) {
    if (!file) continue;
    if (!outputs.empty() && options.json && names_standard_output(*options.json) &&
        names_standard_output(*file))
      usage_error(name, "standard output is taken by --json; name a file for one of them");
    outputs.push_back(*file);
    if (const auto once = check_written_once(outputs, inputs); !once)
      usage_error(name, "{}", once.error().message);
  }
}

}  // namespace

void add_evaluate_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "evaluate",
      "Compare an estimated camera path with the true one, or two halves of the tags",
      "Each estimated pose is compared with the ground truth at its time, which is interpolated. "
      "Beyond its first and last pose it is extrapolated by half of an interval, at most 10 ms. "
      "No alignment: the table frame is known. Overlay error: how far the corners of a 0.2 m cube "
      "on the table's origin are from where the true pose shows them; of a group of tags, one on "
      "the middle of its tags, drawn by the camera's pose and the group's place.\n\n"
      "--split-half needs no ground truth: it tracks a recording with two disjoint halves of its "
      "tags, compares the two overlays, and tests what the residuals come from.\n\n"
      "Example:\n"
      "  penumbra evaluate --estimated out.tum --groundtruth recordings/tabletop/groundtruth.tum "
      "\\\n    --camera recordings/tabletop/camera.yaml\n"
      "  penumbra evaluate --split-half recordings/tabletop --plot halves.svg");
  const auto options = std::make_shared<EvaluateOptions>();
  add_option(command, "--estimated", "FILE.tum", options->estimated,
             "Estimated camera poses, or a frame log (*.csv)");
  add_option(command, "--groundtruth", "FILE.tum", options->groundtruth,
             "True camera poses, or EuRoC's data.csv");
  add_option(command, "--split-half", "RECORDING", options->split_half,
             "Accuracy of a recording without ground truth, by halves of its tags");
  add_option(command, "--camera", "camera.yaml", options->camera,
             "Camera model (--split-half: default the recording's)");
  add_camera_name_option(command, options->camera_name);
  add_option(
      command, "--tags", "tags.yaml", options->tags,
      "Tag map: compares groups beside the table too; --split-half: instead of the recording's");
  const auto take_json = [options](const std::string& file) {
    options->json = file.empty() ? "-" : file;
  };
  add_text_option(
      command, "--json", "[FILE.json]", take_json,
      "JSON on standard output instead of the table; with a file: JSON there, and the table")
      ->expected(0, 1);
  add_option(command, "--plot", "FILE.svg", options->plot,
             "Plot of --split-half: errors over the frames, causes of the residuals");
  add_row_log_option(command, "--per-frame", options->per_frame,
                     "Errors of each pose, as *.csv or *.jsonl; - is standard output");
  start_group(command, "Groups of tags");
  add_option(command, "--estimated-groups", "FOLDER", options->estimated_groups,
             "Estimated poses of groups, as --group-poses writes them");
  add_option(command, "--groundtruth-groups", "FOLDER", options->groundtruth_groups,
             "True poses of groups, as simulate writes them");
  add_tracking_options(command, options->tracking);
  add_pairing_options(command, options->pairing);
  command.callback([&command, options, &chosen] {
    check_options(command, *options);
    check_outputs(command, *options);
    chosen = [options] {
      return options->split_half.empty() ? run_evaluate(*options) : run_evaluate_halves(*options);
    };
  });
}

}  // namespace penumbra
