#include "app/replay/replay_poses.hpp"

#include <algorithm>
#include <filesystem>
#include <map>
#include <utility>

#include "app/logging.hpp"
#include "core/evaluation/pose_convention_hint.hpp"
#include "core/propagate.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
Result<PoseSource> open_replay_poses(const ReplayRequest& request, const Recording& recording,
                                     const Scene& scene) {
  const std::filesystem::path tags = request.tags.value_or(recording.folder / "tags.yaml");
  if (!request.poses_from) {
    TrackerOptions tracking = request.tracking;
    tracking.search_thread = request.threads > 1;
    auto tracker = GroupTracker::create(
        *recording.camera, *recording.tags, tracking,
        wanted_groups(scene, *recording.tags, tags, request, request.plan.skip));
    if (!tracker) return fail_in(tags.string(), tracker.error());
    return PoseSource(std::move(*tracker));
  }
  if (recording.tags) {
    warn_of_unknown_groups(scene, *recording.tags, tags, "it stays where the scene has it");
  }
  if (*request.poses_from == "groundtruth") {
    if (!recording.groundtruth) {
      return fail(
          "{}: there is no such file; give --poses-from a TUM file, or leave it out to track",
          (recording.folder / "groundtruth.tum").string());
    }
    return PoseSource(GivenPoses{*recording.groundtruth, recording.group_groundtruth});
  }
  PENUMBRA_TRY(auto trajectory, load_trajectory(*request.poses_from));
  const bool any = std::any_of(
      recording.frames.begin(), recording.frames.end(),
      [&](const RecordedFrame& frame) { return trajectory.at(frame.timestamp_ns) != nullptr; });
  if (!any) {
    return fail("{}: has no pose within 1 ms of any frame of {}; is it of another recording?",
                *request.poses_from, recording.folder.string());
  }
  // Uses the group poses that were tracked along with the camera's, else the ground truth.
  std::map<std::string, Trajectory> groups = recording.group_groundtruth;
  if (recording.tags) {
    PENUMBRA_TRY(auto tracked,
                 load_group_paths(
                     std::filesystem::path(*request.poses_from).parent_path() / kGroupPosesFolder,
                     other_groups(*recording.tags)));
    for (auto& [group, path] : tracked) groups.insert_or_assign(group, std::move(path));
  }
  return PoseSource(GivenPoses{std::move(trajectory), std::move(groups)});
}

void check_groundtruth(const ReplayRequest& request, const Recording& recording) {
  if (!recording.groundtruth) return;
  Trajectory frames;
  for (const RecordedFrame& frame : recording.frames)
    frames.poses.push_back({frame.timestamp_ns, {}, {}});
  const auto units =
      check_units_of_time({frames, recording.folder.string()},
                          {*recording.groundtruth, "its ground truth"}, request.pairing);
  if (!units) {
    log_warning("{}", units.error().message);
    return;
  }
  for (const std::string& warning : *units) log_warning("{}", warning);
}

void add_accuracy(const ReplayRequest& request, const Recording& recording, const RunRecorder& run,
                  RunReport& report) {
  if (!recording.groundtruth) return;
  const CameraModel& camera = *recording.camera;
  const Trajectory& truth = *recording.groundtruth;
  const Evaluation accuracy = accuracy_of(camera, run, run.tracked(), truth, request.pairing);
  if (accuracy.frames_with_truth > 0) {
    report.accuracy = accuracy;
    const std::string truth_file = (recording.folder / "groundtruth.tum").string();
    if (const auto hint = pose_convention_hint({run.tracked(), "the tracked poses"},
                                               {truth, truth_file}, request.pairing)) {
      log_warning("{}", *hint);
    }
  } else {
    log_warning(
        "{}: its ground truth has no pose at the time of any frame; see --time-offset and "
        "--max-gap",
        recording.folder.string());
  }
  if (report.smoothing) {
    report.smoothing->accuracy = accuracy_of(camera, run, run.drawn(), truth, request.pairing);
  }
  for (GroupReport& group : report.groups) {
    const auto truth_of_group = recording.group_groundtruth.find(group.name);
    if (truth_of_group == recording.group_groundtruth.end()) continue;
    const Evaluation of_group = accuracy_of_group(camera, run, group.name,
                                                  {truth, truth_of_group->second}, request.pairing);
    if (of_group.frames_with_truth > 0) group.accuracy = of_group;
  }
}

}  // namespace penumbra
