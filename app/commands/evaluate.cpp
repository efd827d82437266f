// penumbra evaluate: compares an estimated camera trajectory with the ground truth.

#include "core/evaluation/evaluation.hpp"
#include "core/propagate.hpp"

#include <map>
#include <memory>

#include "app/commands/options.hpp"
#include "app/logging.hpp"
#include "app/recording/recording_source.hpp"
#include "app/report/run_report.hpp"
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
  bool json = false;
};

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
      "{}: has no pose that {} can judge: {}; its times are {}{}, those of the ground truth {}. "
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
  if (options.json) {
    fmt::print("{}", evaluation_json(evaluation, groups));
    return ExitCode::success;
  }
  fmt::print("{}", evaluation_table(evaluation));
  for (const auto& [name, of_group] : groups) {
    fmt::print("\ntag group {}\n{}", name, evaluation_table(of_group));
  }
  return ExitCode::success;
}

}  // namespace

void add_evaluate_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "evaluate", "Compare an estimated camera path with the true one, in the table frame",
      "Each estimated pose is compared with the ground truth at its time, which is interpolated. "
      "Beyond its first and last pose it is extrapolated by half of an interval, at most 10 ms. "
      "No alignment: the table frame is known. Overlay error: how far the corners of a 0.2 m cube "
      "on the table's origin are from where the true pose shows them; of a group of tags, one on "
      "the middle of its tags, drawn by the camera's pose and the group's place.\n\n"
      "Example:\n"
      "  penumbra evaluate --estimated out.tum --groundtruth recordings/tabletop/groundtruth.tum "
      "\\\n    --camera recordings/tabletop/camera.yaml");
  const auto options = std::make_shared<EvaluateOptions>();
  add_option(command, "--estimated", "FILE.tum", options->estimated, "Estimated camera poses")
      ->required();
  add_option(command, "--groundtruth", "FILE.tum", options->groundtruth,
             "True camera poses, or EuRoC's data.csv")
      ->required();
  add_option(command, "--camera", "camera.yaml", options->camera,
             "Camera model for the overlay error")
      ->required();
  add_camera_name_option(command, options->camera_name);
  command.add_flag("--json", options->json, "JSON instead of a table");
  start_group(command, "Groups of tags");
  CLI::Option* tags = add_option(command, "--tags", "tags.yaml", options->tags,
                                 "Tag map: groups of tags beside the table are compared too");
  CLI::Option* estimated_groups =
      add_option(command, "--estimated-groups", "FOLDER", options->estimated_groups,
                 "Estimated places of groups: NAME.tum each, as --group-poses writes them");
  CLI::Option* true_groups =
      add_option(command, "--groundtruth-groups", "FOLDER", options->groundtruth_groups,
                 "Their true places, as simulate writes them");
  tags->needs(estimated_groups)->needs(true_groups);
  estimated_groups->needs(tags);
  true_groups->needs(tags);
  add_pairing_options(command, options->pairing);
  command.callback([options, &chosen] { chosen = [options] { return run_evaluate(*options); }; });
}

}  // namespace penumbra
