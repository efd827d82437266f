#include "app/replay/split_half_run.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <tuple>
#include <utility>

#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/progress.hpp"
#include "app/recording/recording_source.hpp"
#include "calib/refinement/residual_watch.hpp"
#include "calib/survey/tag_corner_meter.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"
#include "tracking/evaluation/pose_velocity.hpp"
#include "tracking/evaluation/tag_halves.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

constexpr int kSplits = 4;
constexpr int kMaxMeasuredFrames = 400;  // frames whose corners are measured, evenly spread

// Result of tracking all tags.
struct FullRun {
  std::vector<TimedPose> poses;
  std::vector<double> map_sigmas_m;  // of each frame, for GroupTracker::set_map_sigma()
  std::vector<FrameCorners> corners;
  std::vector<std::size_t> corner_frames;  // index in `poses` for each element of `corners`
  std::vector<int> frames_seen;            // by tag
  int max_in_view = 0;
  PoseReason reason;  // reason of the last frame that is not tracked
};

// Calls `visit(index, frame)` for every frame, until it fails.
Result<void> for_each_frame(const Recording& recording, InterruptWatch& interrupt, const char* what,
                            const std::function<Result<void>(int, const Frame&)>& visit) {
  PENUMBRA_TRY(auto source, open_recording_source(recording));
  ProgressBar progress(source->frame_count().value_or(0), what);
  for (int index = 0;; ++index) {
    PENUMBRA_TRY(const auto frame, source->next());
    if (!frame) return {};
    PENUMBRA_TRY_VOID(visit(index, *frame));
    progress.update(index + 1);
    if (interrupt.interrupted())
      return fail("{}: ended early, without a result", recording.folder.string());
  }
}

std::vector<MappedTag> table_tags(const TagMap& map) {
  std::vector<MappedTag> tags;
  for (const MappedTag& tag : map.tags()) {
    if (tag.group == kTableGroup) tags.push_back(tag);
  }
  return tags;
}

// Returns a tracker of the tags with these indices.
Result<GroupTracker> tracker_of(const CameraModel& camera, const std::vector<MappedTag>& tags,
                                const std::vector<std::size_t>& indices,
                                const TrackerOptions& options) {
  std::vector<MappedTag> half;
  for (const std::size_t index : indices) half.push_back(tags[index]);
  PENUMBRA_TRY(const auto map, TagMap::make(std::move(half)));
  return GroupTracker::create(camera, map, options, std::vector<std::string>{});
}

Vector6d velocity_of(const std::vector<TimedPose>& poses, std::size_t index) {
  return velocity_at(index > 0 ? &poses[index - 1] : nullptr, poses[index],
                     index + 1 < poses.size() ? &poses[index + 1] : nullptr);
}

Result<FullRun> track_all_tags(const SplitHalfRequest& request, const Recording& recording,
                               const std::vector<MappedTag>& tags, InterruptWatch& interrupt) {
  const CameraModel& camera = *recording.camera;
  std::vector<std::size_t> all(tags.size());
  for (std::size_t i = 0; i < all.size(); ++i) all[i] = i;
  PENUMBRA_TRY(auto tracker, tracker_of(camera, tags, all, request.tracking));
  PENUMBRA_TRY(const auto table_map, TagMap::make(tags));
  PENUMBRA_TRY(const auto watch, ResidualWatch::create(camera, table_map));
  PENUMBRA_TRY(auto meter, TagCornerMeter::create(camera, tags));
  const int frame_count = static_cast<int>(recording.frames.size());
  const int step = (frame_count + kMaxMeasuredFrames - 1) / kMaxMeasuredFrames;
  FullRun run;
  run.frames_seen.assign(tags.size(), 0);
  std::vector<std::uint8_t> scratch;
  const auto visit = [&](int index, const Frame& frame) -> Result<void> {
    run.map_sigmas_m.push_back(watch->map_sigma_m());
    tracker.set_map_sigma(watch->map_sigma_m());
    TrackedFrame result = tracker.track(frame);
    const PoseEstimate estimate = result.pose;
    // The notices would repeat the causes that are reported.
    std::ignore = watch->observe(result);
    const bool tracked = estimate.status == TrackStatus::tracked;
    run.poses.push_back({frame.timestamp_ns, std::nullopt});
    if (!tracked) run.reason = estimate.reason;
    if (!estimate.has_pose() || estimate.tags_used == 0) return {};
    const MapFromCamera pose = as_map_pose(estimate.T_table_camera);
    const std::vector<std::size_t> in_view = meter.in_view(pose);
    run.max_in_view = std::max(run.max_in_view, static_cast<int>(in_view.size()));
    for (const std::size_t tag : in_view) ++run.frames_seen[tag];
    run.poses.back().pose = pose;
    if (index % std::max(step, 1) != 0) return {};
    run.corner_frames.push_back(run.poses.size() - 1);
    run.corners.push_back(
        meter.measure(luma(frame, scratch), pose, velocity_of(run.poses, run.poses.size() - 1)));
    return {};
  };
  PENUMBRA_TRY_VOID(for_each_frame(recording, interrupt, "frames", visit));
  for (std::size_t i = 0; i < run.corners.size(); ++i)
    run.corners[i].velocity = velocity_of(run.poses, run.corner_frames[i]);
  return run;
}

// Fails if no frame can be compared.
Result<void> check_tags_in_view(const SplitHalfRequest& request, const FullRun& run) {
  const std::string name = request.recording.string();
  if (run.poses.empty()) return fail("{}: holds no frame", name);
  if (run.max_in_view == 0) {
    return fail("{}: no frame shows its tags: {}; name the right tag map with --tags FILE", name,
                run.reason.cause == PoseCause::none ? "none was found" : text_of(run.reason));
  }
  if (run.max_in_view >= kMinSplitTags) return {};
  return fail(
      "{}: no frame shows more than {} tag{}, which is not sufficient: --split-half needs {} or "
      "more, half of them for each pose; record a sheet with more tags in view",
      name, run.max_in_view, run.max_in_view == 1 ? "" : "s", kMinSplitTags);
}

// Splits the tags that were seen. Returns indices into `tags`.
std::vector<TagHalves> choose_halves(const std::vector<MappedTag>& tags, const FullRun& run) {
  std::vector<WeightedTag> seen;
  std::vector<std::size_t> indices;
  for (std::size_t i = 0; i < tags.size(); ++i) {
    if (run.frames_seen[i] == 0) continue;
    indices.push_back(i);
    seen.push_back({tags[i].T_table_tag.translation(), static_cast<double>(run.frames_seen[i]) /
                                                           static_cast<double>(run.poses.size())});
  }
  std::vector<TagHalves> splits = balanced_halves(seen, kSplits);
  for (TagHalves& halves : splits) {
    for (auto& half : halves) {
      for (std::size_t& index : half) index = indices[index];
    }
  }
  return splits;
}

Result<std::vector<SplitReport>> track_halves(const SplitHalfRequest& request,
                                              const Recording& recording,
                                              const std::vector<MappedTag>& tags,
                                              const std::vector<TagHalves>& splits,
                                              const std::vector<double>& map_sigmas_m,
                                              InterruptWatch& interrupt) {
  const CameraModel& camera = *recording.camera;
  std::vector<SplitReport> reports(splits.size());
  std::vector<std::array<GroupTracker, 2>> trackers;
  for (std::size_t i = 0; i < splits.size(); ++i) {
    for (std::size_t half = 0; half < 2; ++half) {
      for (const std::size_t index : splits[i][half])
        reports[i].ids[half].push_back(tags[index].id);
    }
    PENUMBRA_TRY(auto first, tracker_of(camera, tags, splits[i][0], request.tracking));
    PENUMBRA_TRY(auto second, tracker_of(camera, tags, splits[i][1], request.tracking));
    trackers.push_back({std::move(first), std::move(second)});
  }
  const auto visit = [&](int index, const Frame& frame) -> Result<void> {
    for (std::size_t i = 0; i < splits.size(); ++i) {
      for (GroupTracker& tracker : trackers[i])
        tracker.set_map_sigma(map_sigmas_m.at(static_cast<std::size_t>(index)));
      const PoseEstimate first = trackers[i][0].track(frame).pose;
      const PoseEstimate second = trackers[i][1].track(frame).pose;
      const HalfDifference difference = compare_halves(camera, frame.timestamp_ns, first, second);
      reports[i].frames.push_back(difference);
      if (request.on_compared) PENUMBRA_TRY_VOID(request.on_compared(frame, i, difference));
    }
    return {};
  };
  PENUMBRA_TRY_VOID(for_each_frame(recording, interrupt, "frames", visit));
  return reports;
}

std::string rejections_text(const SplitHalfErrors& errors) {
  std::string text;
  for (std::size_t i = 0; i < kHalfRejections; ++i) {
    if (errors.frames_rejected[i] == 0) continue;
    text += fmt::format("{}{}: {}", text.empty() ? "" : ", ",
                        text_of(static_cast<HalfRejection>(i)), errors.frames_rejected[i]);
  }
  return text;
}

}  // namespace

Result<SplitHalfReport> run_split_half(const SplitHalfRequest& request) {
  OpenRecordingOptions open;
  open.camera_name = request.camera_name;
  open.camera = request.camera;
  open.tags = request.tags;
  PENUMBRA_TRY(const auto recording, open_recording(request.recording, open));
  for (const std::string& notice : recording.notices) log_warning("{}", notice);
  const std::filesystem::path tag_file = request.tags.value_or(recording.folder / "tags.yaml");
  const std::vector<MappedTag> tags = table_tags(*recording.tags);
  if (tags.empty())
    return fail("{}: has no tag in the group 'table', which defines the poses", tag_file.string());
  InterruptWatch interrupt;
  interrupt.hold();
  PENUMBRA_TRY(const auto run, track_all_tags(request, recording, tags, interrupt));
  PENUMBRA_TRY_VOID(check_tags_in_view(request, run));
  SplitHalfReport report;
  report.recording = request.recording;
  report.tags = tags_in_use(tag_file, *recording.tags);
  report.frames = static_cast<int>(run.poses.size());
  report.given_row_s = recording.camera->parameters().rolling_shutter_row_s.value_or(0.0);
  PENUMBRA_TRY(report.splits, track_halves(request, recording, tags, choose_halves(tags, run),
                                           run.map_sigmas_m, interrupt));
  std::vector<HalfDifference> pooled;
  for (SplitReport& split : report.splits) {
    split.errors = split_half_errors(split.frames);
    pooled.insert(pooled.end(), split.frames.begin(), split.frames.end());
  }
  report.pooled = split_half_errors(pooled);
  report.causes = find_residual_causes(*recording.camera, tags, run.corners);
  // The residuals show what is wrong, also where every half is uncertain because of it.
  if (report.pooled.frames_compared == 0 && report.causes.frames == 0) {
    return fail(
        "{}: no frame could be compared ({}), and fewer than {} frames can be measured; record the "
        "tags longer, closer, sharper or with more of them in view",
        request.recording.string(), rejections_text(report.pooled), kMinResidualFrames);
  }
  return report;
}

}  // namespace penumbra
