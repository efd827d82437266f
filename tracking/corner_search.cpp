#include "tracking/corner_search.hpp"

#include <algorithm>
#include <utility>

#include "core/geometry/group_pose.hpp"
#include "core/stopwatch.hpp"

namespace penumbra {
namespace {

// Ratio of the RMS of second and best pose, below which the second may be the true one.
constexpr double kAmbiguityRatio = 1.6;
constexpr double kMaxReprojectionRms_px = 3.0;  // maximum of a valid pose

void use_corner_pose(Measurement& measurement) {
  const BoardPose& board = measurement.by_corners;
  measurement.best = board.best;
  measurement.second = board.second;
  measurement.ambiguity_ratio = board.ambiguity_ratio();
  measurement.ambiguous = board.is_ambiguous(kAmbiguityRatio);
}

// Returns true if 2/3 of the tags that should be readable were detected.
bool shows_most_tags(const RigidTags& group, const Measurement& measurement) {
  return 3 * measurement.tags_used >= 2 * group.in_view(measurement.best.T_map_camera);
}

// Returns true if a finer search would find no other pose, nor inconsistent tags.
bool is_conclusive(const RigidTags& group, const Measurement& measurement) {
  return !measurement.inconsistent && !measurement.ambiguous && measurement.tags_used > 1 &&
         shows_most_tags(group, measurement);
}

}  // namespace

MeasurementResult CornerSearch::measure(const RigidTags& group,
                                        std::span<const TagDetection> detections,
                                        TrackTimes& times) {
  const Stopwatch solve;
  observations_.clear();
  bool seen_twice = false;
  int unknown_tags = 0;
  for (const TagDetection& detection : detections) {
    if (map_.find(detection.family, detection.id) == nullptr) ++unknown_tags;
    const auto tag = std::ranges::find_if(group.tags, [&detection](const MappedTag& own) {
      return own.family == detection.family && own.id == detection.id;
    });
    // Skips other groups, which may have moved.
    if (tag == group.tags.end()) continue;
    const auto same = [&](const TagDetection& other) {
      return other.family == detection.family && other.id == detection.id;
    };
    if (std::count_if(detections.begin(), detections.end(), same) > 1) {
      seen_twice = true;  // it is unknown which detection is the tag in the map
      continue;
    }
    const auto index = static_cast<int>(tag - group.tags.begin());
    observations_.push_back({index, tag->corners(), detection.corners_px});
  }
  auto board = estimate_board_pose(group.camera, observations_);
  solve.add_to(times.solve_ms, times.solve_cpu_ms);
  if (!board) {
    if (observations_.empty() && seen_twice)
      return tl::unexpected(PoseReason{PoseCause::tag_twice});
    // A single unknown tag may be a false detection.
    if (observations_.empty() && unknown_tags > 1)
      return tl::unexpected(PoseReason{.cause = PoseCause::tags_not_in_map, .tags = unknown_tags});
    return tl::unexpected(PoseReason{board.error()});
  }
  Measurement measurement;
  measurement.by_corners = std::move(*board);
  use_corner_pose(measurement);
  measurement.tags_used = measurement.by_corners.tags_used;
  measurement.inconsistent = measurement.by_corners.inconsistent;
  measurement.rejected = measurement.by_corners.rejected;
  if (measurement.best.rms_px > kMaxReprojectionRms_px)
    return tl::unexpected(PoseReason{PoseCause::misfit, measurement.best.rms_px});
  return measurement;
}

void CornerSearch::refine(const RigidTags& group, Measurement& measurement, TrackTimes& times) {
  if (measurement.aligned || std::exchange(measurement.by_ceres, true)) return;
  const Stopwatch solve;
  finish_by_ceres(group.camera, measurement.by_corners);
  use_corner_pose(measurement);
  solve.add_to(times.solve_ms, times.solve_cpu_ms);
}

MeasurementResult CornerSearch::detect(const RigidTags& group, SearchResolution resolution,
                                       TrackTimes& times) {
  const bool searched_already = search_->searched(resolution);
  const Stopwatch detect;
  const std::vector<TagDetection>& detections = search_->tags(resolution);
  if (!searched_already) {  // the time of an earlier search is included already
    detect.add_to(times.detect_ms, times.detect_cpu_ms);
    times.full_detection = true;
  }
  return measure(group, detections, times);
}

MeasurementResult CornerSearch::find(const RigidTags& group, SearchResolution finest,
                                     const std::optional<MapFromCamera>& predicted,
                                     TrackTimes& times) {
  const auto box =
      predicted && finest != SearchResolution::quarter ? group.box_about(*predicted) : std::nullopt;
  if (box && !search_->searched(SearchResolution::half)) {
    const Stopwatch detect;
    const std::vector<TagDetection> tags_in_box = search_->tags_within(*box);
    detect.add_to(times.detect_ms, times.detect_cpu_ms);
    MeasurementResult in_box = measure(group, tags_in_box, times);
    times.roi_detection = in_box && is_conclusive(group, *in_box);
    if (times.roi_detection) return in_box;
  }
  const bool first = !std::exchange(searched_before_, true) && finest == SearchResolution::full;
  if (finest == SearchResolution::full && std::exchange(full_next_, !full_next_))
    return detect(group, SearchResolution::full, times);
  // A search at a quarter of the resolution takes 1/4 of the time at half resolution.
  MeasurementResult quarter = detect(group, SearchResolution::quarter, times);
  if (quarter && is_conclusive(group, *quarter)) return quarter;
  if (finest == SearchResolution::quarter) {
    if (!quarter) return quarter;
    return tl::unexpected(PoseReason{PoseCause::few_tags});
  }
  MeasurementResult half = detect(group, SearchResolution::half, times);
  const bool enough = half && !half->inconsistent && shows_most_tags(group, *half);
  if (!first || enough) return half;
  MeasurementResult full = detect(group, SearchResolution::full, times);
  return full ? full : half;
}

}  // namespace penumbra
