#include "calib/refinement/map_refiner.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "calib/survey/row_time.hpp"
#include "calib/survey/sweep.hpp"
#include "calib/survey/tag_edges.hpp"
#include "calib/survey/tag_survey.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/propagate.hpp"
#include "core/statistics.hpp"
#include "tracking/detection/pose_refiner.hpp"
#include "tracking/detection/pose_solver.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {
namespace {

// Maximum error of a refined map in held-out keyframes, as a fraction of the given map's error. The
// given map may be exact, and errors that all frames have in common would bend it.
constexpr double kMaxOfGiven = 0.7;
// The same for an earlier refined map. It was made from some of these keyframes, so its error is
// slightly too small.
constexpr double kMaxOfRefined = 1.25;
constexpr std::size_t kMinSightings = 8;  // minimum number of tag sightings to compare two maps
// Errors of sightings are bounded by this multiple of their median.
constexpr double kOutlier = 4.0;

using Detections = std::vector<std::vector<TagDetection>>;  // by keyframe
using TablePose = Transform<frame::Table, frame::Table>;

std::optional<TagFamily> main_family(const TagMap& map) {
  std::map<TagFamily, int> counts;
  for (const MappedTag& tag : map.tags()) {
    if (tag.group == kTableGroup) ++counts[tag.family];
  }
  const auto most = std::ranges::max_element(counts, {}, [](const auto& c) { return c.second; });
  return most == counts.end() ? std::nullopt : std::optional(most->first);
}

const MappedTag* find_on_table(const TagMap& map, TagFamily family, int id) {
  const MappedTag* tag = map.find(family, id);
  return tag != nullptr && tag->group == kTableGroup ? tag : nullptr;
}

Result<Detections> detect_tags(const TagMap& map, TagFamily family, const KeyframeList& keyframes,
                               const std::stop_token& stop) {
  PENUMBRA_TRY(TagDetector detector, TagDetector::create(std::array{family}));
  Detections detections;
  for (const auto& keyframe : keyframes) {
    if (stop.stop_requested()) return fail("ended early");
    auto& tags = detections.emplace_back(detector.detect(keyframe->luma()));
    std::erase_if(tags, [&](const TagDetection& tag) {
      return find_on_table(map, family, tag.id) == nullptr;
    });
  }
  return detections;
}

struct KeyframeSurvey {
  bool with_held_out = false;
  bool refine_camera = false;
  std::vector<double> lens_sigmas;  // as in SurveyOptions
};

// Surveys keyframes. The table frame is that of one of the tags.
Result<TagSurvey> survey_keyframes(const CameraModel& camera, const TagMap& map, TagFamily family,
                                   const KeyframeList& keyframes, const Detections& detections,
                                   const KeyframeSurvey& request, const std::stop_token& stop) {
  SurveyOptions options;
  options.lens_sigmas = request.lens_sigmas;
  options.family = family;
  options.plane = SurveyPlane::anchor;
  options.stop = stop;
  KeyframeList used;
  std::vector<SurveyFrame> frames;
  std::map<int, int> seen;  // number of sightings by id
  for (std::size_t k = 0; k < keyframes.size(); ++k) {
    if (keyframes[k]->held_out && !request.with_held_out) continue;
    used.push_back(keyframes[k]);
    frames.push_back({detections[k], {}, 0.0, keyframes[k]->velocity});
    for (const TagDetection& tag : detections[k]) ++seen[tag.id];
  }
  if (seen.empty()) return fail("no tag of the table was detected");
  for (const MappedTag& tag : map.tags()) {
    if (tag.group == kTableGroup && tag.family == family) options.sizes_m[tag.id] = tag.size_m;
  }
  options.anchor =
      std::ranges::max_element(seen, {}, [](const auto& count) { return count.second; })->first;
  SweepSteps steps;
  steps.survey = [&](const CameraModel& with, std::span<const SurveyFrame> all, bool with_lens) {
    options.refine_camera = with_lens;
    return survey_tags(with, all, options);
  };
  steps.measure = [&](const TagSurvey& surveyed, std::vector<SurveyFrame>& all) -> Result<void> {
    for (std::size_t f = 0; f < all.size(); ++f) {
      if (stop.stop_requested()) return fail("ended early");
      all[f] = measured_frame(surveyed, f, all[f], used[f]->luma());
    }
    return {};
  };
  PENUMBRA_TRY(SweptTags swept, survey_sweep(camera, std::move(frames), steps,
                                             {RowTimeGoal::given, request.refine_camera}));
  return std::move(swept.survey);
}

// A surveyed tag and the same tag in the given map.
struct TagPair {
  MappedTag surveyed;
  const MappedTag* given = nullptr;
};

// Returns the pose of the survey's frame in the table frame that brings the corners closest to the
// given ones.
TablePose fit_corners(std::span<const TagPair> pairs) {
  Eigen::Matrix3Xd from(3, 4 * pairs.size());
  Eigen::Matrix3Xd to(3, 4 * pairs.size());
  Eigen::Index column = 0;
  for (const TagPair& pair : pairs) {
    const auto surveyed = pair.surveyed.corners();
    const auto given = pair.given->corners();
    for (std::size_t c = 0; c < 4; ++c, ++column) {
      from.col(column) = surveyed[c];
      to.col(column) = given[c];
    }
  }
  const Eigen::Matrix4d T = Eigen::umeyama(from, to, false);
  return {Eigen::Matrix3d(T.topLeftCorner<3, 3>()), Eigen::Vector3d(T.topRightCorner<3, 1>())};
}

// Returns how far a tag is from its place in the given map. Paper that bends displaces tags mostly
// along their normals. Above 1, the tag was moved.
double displacement(const TagPair& pair, const TablePose& T_table_survey) {
  constexpr double kMaxAlong = 0.05;  // within the tag's plane / tag size
  constexpr double kMaxNormal = 0.5;  // along its normal / tag size
  const Eigen::Vector3d moved = pair.given->T_table_tag.inverse() *
                                (T_table_survey * pair.surveyed.T_table_tag.translation()) /
                                pair.given->size_m;
  return std::max(moved.head<2>().norm() / kMaxAlong, std::abs(moved.z()) / kMaxNormal);
}

// Like fit_corners(), but drops moved tags one by one, worst first, and keeps half of the tags.
TablePose align_to_given(std::vector<TagPair> pairs) {
  const std::size_t min_count = (pairs.size() + 1) / 2;
  for (;;) {
    const TablePose T_table_survey = fit_corners(pairs);
    const auto worst = std::ranges::max_element(
        pairs, {}, [&](const TagPair& pair) { return displacement(pair, T_table_survey); });
    if (pairs.size() <= min_count || !(displacement(*worst, T_table_survey) > 1.0))
      return T_table_survey;
    pairs.erase(worst);
  }
}

// Returns the current map with the surveyed tags.
Result<TagMap> merged(const MapsToRefine& maps, const TagSurvey& survey) {
  std::vector<TagPair> pairs;
  for (const SurveyedTag& tag : survey.tags) {
    if (const MappedTag* given = find_on_table(maps.given, tag.tag.family, tag.tag.id))
      pairs.push_back({tag.tag, given});
  }
  const TablePose T_table_survey = align_to_given(pairs);
  std::vector<MappedTag> tags = maps.current.tags();
  for (MappedTag& tag : tags) {
    const auto pair = std::ranges::find_if(pairs, [&](const TagPair& other) {
      return other.surveyed.id == tag.id && other.surveyed.family == tag.family;
    });
    if (pair == pairs.end() || tag.group != kTableGroup) continue;
    tag.T_table_tag = T_table_survey * pair->surveyed.T_table_tag;
    tag.curvature = pair->surveyed.curvature;
  }
  return TagMap::make(std::move(tags));
}

// Squared errors of one sighting's corners with two maps, after a pose fit of each [px^2].
struct ComparedSighting {
  double current = 0.0;
  double refined = 0.0;
};

// Measures the corners of the tag's plane near a pose; returns nullopt if too few edges are found.
std::optional<MeasuredTag> measured_corners(
    ImageView luma, const CameraModel& camera, const MappedTag& tag,
    const Transform<frame::Camera, frame::Tag>& T_camera_tag) {
  const auto pattern = TagPattern::make(tag.family, tag.id);
  if (!pattern) return std::nullopt;
  return measure_tag(luma, camera, *pattern, tag, T_camera_tag);
}

// The tags of one frame by one map, and their measured corners.
struct MeasuredFrame {
  std::vector<MappedTag> tags;
  FrameCorners corners;

  void add(const MappedTag& tag, const MeasuredTag& measured) {
    corners.tags.push_back({tags.size(), measured.corners_px, 0.0});
    tags.push_back(tag);
  }
};

// Returns the mean squared error of each tag's corners at the motion that fits all corners [px^2].
std::optional<std::vector<double>> squared_errors(const CameraModel& camera,
                                                  const MeasuredFrame& frame) {
  const auto at_rest = at_middle_row(camera, frame.tags, frame.corners);
  if (!at_rest) return std::nullopt;
  std::vector<PointObservation> corners;
  for (const TagCorners& seen : at_rest->tags) {
    const MappedTag& tag = frame.tags[seen.tag];
    const auto on_tag = tag_corners(tag.size_m);
    for (std::size_t c = 0; c < 4; ++c)
      corners.push_back({tag.T_table_tag * on_tag[c], seen.corners_px[c]});
  }
  const auto fit = refine_pose(camera, corners, at_rest->T_map_camera);
  if (!fit) return std::nullopt;
  const auto T_camera_map = fit->T_map_camera.inverse();
  std::vector<double> squares(corners.size() / 4);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const auto pixel = camera.project(T_camera_map * corners[i].p_map);
    if (!pixel) return std::nullopt;
    squares[i / 4] += 0.25 * (*pixel - corners[i].pixel).squaredNorm();
  }
  return squares;
}

// Compares two maps in one keyframe that shows at least two tags.
std::vector<ComparedSighting> compare_in(const MapKeyframe& keyframe,
                                         std::span<const TagDetection> detections,
                                         const CameraModel& camera, const TagMap& current,
                                         const TagMap& refined) {
  std::vector<PointObservation> detected;
  for (const TagDetection& tag : detections) {
    const auto corners = refined.find(tag.family, tag.id)->corners();
    for (std::size_t c = 0; c < 4; ++c) detected.push_back({corners[c], tag.corners_px[c]});
  }
  const auto poses = solve_pose(camera, detected);
  const auto fit = poses.empty() ? std::nullopt : refine_pose(camera, detected, poses.front());
  if (!fit) return {};
  const auto T_camera_table = as_table_pose(fit->T_map_camera).inverse();
  const bool rolls = camera.parameters().rolling_shutter_row_s.value_or(0.0) > 0.0;
  if (rolls && !keyframe.velocity) return {};
  MeasuredFrame by_current{{},
                           {fit->T_map_camera, keyframe.velocity.value_or(Vector6d::Zero()), {}}};
  MeasuredFrame by_refined = by_current;
  for (const TagDetection& detection : detections) {
    const MappedTag& now = *refined.find(detection.family, detection.id);
    const MappedTag& before = *current.find(detection.family, detection.id);
    // Both are measured at the same pose, on paper with the map's curvature.
    const auto T_camera_tag = T_camera_table * now.T_table_tag;
    const auto corners = measured_corners(keyframe.luma(), camera, now, T_camera_tag);
    const auto corners_before = measured_corners(keyframe.luma(), camera, before, T_camera_tag);
    if (!corners || !corners_before) continue;
    by_refined.add(now, *corners);
    by_current.add(before, *corners_before);
  }
  if (by_refined.tags.size() < 2) return {};
  const auto old_errors = squared_errors(camera, by_current);
  const auto new_errors = squared_errors(camera, by_refined);
  if (!old_errors || !new_errors) return {};
  std::vector<ComparedSighting> sightings;
  for (std::size_t i = 0; i < new_errors->size(); ++i)
    sightings.push_back({(*old_errors)[i], (*new_errors)[i]});
  return sightings;
}

// RMS errors of two maps in the held-out keyframes [px].
struct MapErrors {
  double current_px = 0.0;
  double refined_px = 0.0;
};

// Compares two maps in the held-out keyframes. Fails if they show too few tags.
Result<MapErrors> compare_maps(const CameraModel& camera, const TagMap& current,
                               const TagMap& refined, const KeyframeList& keyframes,
                               const Detections& detections) {
  std::vector<ComparedSighting> sightings;
  for (std::size_t k = 0; k < keyframes.size(); ++k) {
    if (!keyframes[k]->held_out) continue;
    const auto compared = compare_in(*keyframes[k], detections[k], camera, current, refined);
    sightings.insert(sightings.end(), compared.begin(), compared.end());
  }
  if (sightings.size() < kMinSightings) return fail("the held-out keyframes show too few tags");
  std::vector<double> better;
  for (const ComparedSighting& sighting : sightings)
    better.push_back(std::min(sighting.current, sighting.refined));
  // Bounds both errors of a sighting alike: one of the maps may have moved the tag.
  const double limit = kOutlier * kOutlier * upper_median(std::move(better));
  MapErrors sums;
  double count = 0.0;
  for (const ComparedSighting& sighting : sightings) {
    if (sighting.current > limit && sighting.refined > limit) continue;  // covered or misread
    sums.current_px += std::min(sighting.current, limit);
    sums.refined_px += std::min(sighting.refined, limit);
    count += 1.0;
  }
  return MapErrors{std::sqrt(sums.current_px / count), std::sqrt(sums.refined_px / count)};
}

// Fails if the refined map does not explain the held-out keyframes clearly better than the given
// one, or if it is worse than the current one.
Result<void> check_better(const CameraModel& camera, const MapsToRefine& maps,
                          const TagMap& refined, const KeyframeList& keyframes,
                          const Detections& detections) {
  const auto check = [&](const TagMap& other, std::string_view name,
                         double max_ratio) -> Result<void> {
    PENUMBRA_TRY(const MapErrors errors,
                 compare_maps(camera, other, refined, keyframes, detections));
    if (errors.refined_px < max_ratio * errors.current_px) return {};
    return fail(
        "the refined map has an error of {:.3f} px in held-out keyframes, the {} map {:.3f}",
        errors.refined_px, name, errors.current_px);
  };
  PENUMBRA_TRY_VOID(check(maps.given, "given", kMaxOfGiven));
  if (change_of_map(maps.given, maps.current).max_m == 0.0) return {};
  return check(maps.current, "current", kMaxOfRefined);
}

}  // namespace

Result<TagMap> refine_map(const CameraModel& camera, const MapsToRefine& maps,
                          const KeyframeList& keyframes, std::stop_token stop) {
  const std::optional<TagFamily> family = main_family(maps.given);
  if (!family) return fail("the map has no tag on the table");
  PENUMBRA_TRY(const Detections detections, detect_tags(maps.given, *family, keyframes, stop));
  PENUMBRA_TRY(const TagSurvey without_held_out,
               survey_keyframes(camera, maps.given, *family, keyframes, detections, {}, stop));
  PENUMBRA_TRY(const TagMap trial, merged(maps, without_held_out));
  PENUMBRA_TRY_VOID(check_better(camera, maps, trial, keyframes, detections));
  PENUMBRA_TRY(const TagSurvey survey, survey_keyframes(camera, maps.given, *family, keyframes,
                                                        detections, {true, false, {}}, stop));
  return merged(maps, survey);
}

Result<RefinedLens> refine_lens(const CameraModel& camera, const MapsToRefine& maps,
                                const KeyframeList& keyframes,
                                const std::vector<double>& lens_sigmas, std::stop_token stop) {
  const std::optional<TagFamily> family = main_family(maps.given);
  if (!family) return fail("the map has no tag on the table");
  if (keyframes.size() < MapKeyframes::kRefinementInterval) {
    return fail("there are {} keyframes from different sides, {} are needed", keyframes.size(),
                MapKeyframes::kRefinementInterval);
  }
  PENUMBRA_TRY(const Detections detections, detect_tags(maps.given, *family, keyframes, stop));
  PENUMBRA_TRY(TagSurvey survey, survey_keyframes(camera, maps.given, *family, keyframes,
                                                  detections, {true, true, lens_sigmas}, stop));
  if (!survey.lens_is_refined()) return fail("the keyframes do not show a better lens");
  PENUMBRA_TRY(TagMap map, merged(maps, survey));
  return RefinedLens{std::move(map), std::move(survey)};
}

MapChange change_of_map(const TagMap& before, const TagMap& after) {
  MapChange change;
  double sum = 0.0;
  int corners = 0;
  for (std::size_t i = 0; i < before.tags().size(); ++i) {
    if (before.tags()[i].group != kTableGroup) continue;
    const auto then = before.tags()[i].corners();
    const auto now = after.tags()[i].corners();
    for (std::size_t c = 0; c < 4; ++c) {
      const double distance_m = (now[c] - then[c]).norm();
      sum += distance_m * distance_m;
      change.max_m = std::max(change.max_m, distance_m);
      ++corners;
    }
  }
  change.rms_m = corners > 0 ? std::sqrt(sum / corners) : 0.0;
  return change;
}

}  // namespace penumbra
