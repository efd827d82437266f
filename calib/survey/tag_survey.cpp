#include "calib/survey/tag_survey.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <ranges>
#include <set>
#include <utility>

#include "calib/solver/silence.hpp"
#include "calib/survey/lens_refinement.hpp"
#include "calib/survey/paper_shape.hpp"
#include "calib/survey/table_plane.hpp"
#include "calib/survey/tag_graph.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "tracking/math/se3.hpp"

namespace penumbra {
namespace {

// Camera response and blur shift a readable tag's edges by less than this. A larger solved shift is
// wrong: together with the scale it compensates another error (board warp, lens).
constexpr double kMaxEdgeShift_px = 0.5;

// The used frames with their unique, completely visible tags.
struct SurveyInput {
  std::vector<std::vector<TagSighting>> frames;
  std::vector<std::size_t> of;  // for each used frame: its index among the given frames
  std::map<int, int> seen;      // number of used frames by tag id
  std::set<int> without_size;
  Eigen::MatrixXd lens_prior;  // empty: the lens is fixed
};

SurveyInput input_of(const CameraModel& camera, std::span<const SurveyFrame> frames,
                     const SurveyOptions& options) {
  SurveyInput input;
  const auto is_measured = [](const SurveyFrame& frame, std::size_t i) {
    return i < frame.measured.size() && frame.measured[i].has_value();
  };
  std::map<int, int> detected;
  std::map<int, int> measured;
  for (const SurveyFrame& frame : frames) {
    for (std::size_t i = 0; i < frame.tags.size(); ++i) {
      ++detected[frame.tags[i].id];
      if (is_measured(frame, i)) ++measured[frame.tags[i].id];
    }
  }
  const auto max_frames = static_cast<std::size_t>(options.max_frames);
  const std::size_t step = std::max<std::size_t>(1, (frames.size() + max_frames - 1) / max_frames);
  for (std::size_t f = 0; f < frames.size(); f += step) {
    const SurveyFrame& frame = frames[f];
    std::map<int, int> times;
    for (const TagDetection& tag : frame.tags) ++times[tag.id];
    std::vector<TagSighting>& here = input.frames.emplace_back();
    input.of.push_back(f);
    for (std::size_t i = 0; i < frame.tags.size(); ++i) {
      const TagDetection& tag = frame.tags[i];
      if (times[tag.id] > 1) continue;  // ambiguous
      double size = options.size_m(tag.id);
      if (size <= 0.0) {
        // The tag is not placed, but its size is estimated.
        input.without_size.insert(tag.id);
        size = options.size_m(options.anchor);
        if (size <= 0.0) continue;
      }
      const bool inside = std::ranges::all_of(tag.corners_px, [&](const Eigen::Vector2d& corner) {
        return corner.x() > 2.0 && corner.y() > 2.0 && corner.x() < camera.width() - 3 &&
               corner.y() < camera.height() - 3;
      });
      if (!inside) continue;
      // A tag whose edges are found in most frames, but not here, is partly occluded.
      const bool edges = is_measured(frame, i);
      if (!edges && 2 * measured[tag.id] > detected[tag.id]) continue;
      here.push_back(edges ? sighting_of(tag.id, size, *frame.measured[i])
                           : sighting_of(tag.id, size, tag.corners_px));
      if (input.without_size.count(tag.id) == 0) ++input.seen[tag.id];
    }
  }
  return input;
}

// Alternately poses cameras by placed tags and places tags by posed cameras, from the anchor
// outwards. Skips the tags in `without`.
Result<void> chain(TagGraph& graph, const SurveyInput& input, int anchor,
                   const std::set<int>& without) {
  constexpr double kPlaced = 3.0;  // [px] median error; worse tags wait for better cameras
  graph.tags[anchor] = Pose6{};
  for (bool grew = true; grew;) {
    grew = false;
    graph.pose_cameras();
    std::optional<std::pair<int, TagPlacement>> next_best;
    for (const auto& [id, count] : input.seen) {
      if (graph.tags.count(id) > 0 || without.count(id) > 0) continue;
      auto fit = graph.place(id);
      if (!fit) continue;
      if (fit->median_px() < kPlaced) {
        graph.tags[id] = packed(fit->T_anchor_tag);
        grew = true;
      } else if (!next_best || fit->median_px() < next_best->second.median_px()) {
        next_best.emplace(id, std::move(*fit));
      }
    }
    if (!grew && next_best && next_best->second.median_px() < kMaxSightingError_px) {
      graph.tags[next_best->first] = packed(next_best->second.T_anchor_tag);
      grew = true;
    }
    if (grew && !graph.adjust(true))
      return fail(
          "the positions of the tags do not converge; sweep slower, and over two or more tags at a "
          "time");
  }
  if (std::ranges::none_of(graph.cameras, [](const auto& pose) { return pose.has_value(); })) {
    return fail("tag {} alone never determines the camera's pose; come closer to it, at an angle",
                anchor);
  }
  return {};
}

struct AdjustedGraph {
  TagGraph graph;  // without outliers
  double rms_px = 0.0;
  std::map<int, double> lost;  // fraction of outlier sightings by placed tag
  std::set<int> misfits;       // visible in posed frames, but not placed
};

// Chains and bundle adjusts all tags that are not in `without`.
Result<AdjustedGraph> settle(const CameraModel& camera, const SurveyInput& input, int anchor,
                             const std::set<int>& without, const SurveyOptions& options) {
  AdjustedGraph result{TagGraph(camera, anchor), 0.0, {}, {}};
  TagGraph& graph = result.graph;
  graph.stop = options.stop;
  graph.frames = input.frames;
  graph.shift_is_free = false;
  PENUMBRA_TRY_VOID(chain(graph, input, anchor, without));
  const TagGraph without_shift = graph;
  graph.shift_is_free = true;
  const auto adjust = [&] {
    for (int round = 0; round < 4; ++round) {
      if (!graph.adjust(round == 0)) return false;
      if (!graph.drop_outliers(result.rms_px) && round > 0) break;
    }
    return true;
  };
  bool settled = adjust();
  if (settled && std::abs(graph.shift) > kMaxEdgeShift_px) {
    graph = without_shift;
    settled = adjust();
  }
  if (settled && input.lens_prior.size() > 0) {
    graph.lens_prior = input.lens_prior;
    settled = adjust_lens(graph) && adjust() && adjust_lens(graph);
  }
  if (!settled) return fail("the positions of the tags do not converge; sweep slower");
  std::map<int, std::pair<int, int>> counts;  // sightings, and those without outliers
  for (std::size_t f = 0; f < input.frames.size(); ++f) {
    if (!graph.cameras[f]) continue;
    for (const TagSighting& sighting : input.frames[f]) ++counts[sighting.id].first;
    for (const TagSighting& sighting : graph.frames[f]) ++counts[sighting.id].second;
  }
  for (const auto& [id, count] : counts) {
    if (graph.tags.count(id) > 0) {
      result.lost[id] = 1.0 - static_cast<double>(count.second) / count.first;
    } else if (count.first >= 2 && input.without_size.count(id) == 0) {
      result.misfits.insert(id);
    }
  }
  return result;
}

// A single movement of a tag during the sweep.
struct Movement {
  std::size_t frame = 0;    // first frame after the movement
  double distance_m = 0.0;  // maximum over the corners
  double mean_px = 0.0;     // TagPlacement::mean_px() with two placements
};

// `judge` must have all sightings, and cameras that hardly depend on this tag.
std::optional<Movement> movement_of(const TagGraph& judge, int id, double size_m) {
  constexpr std::size_t kMinSeen = 3;  // minimum sightings before and after
  const auto seen = judge.sightings_of(id);
  if (seen.size() < 2 * kMinSeen) return std::nullopt;
  std::optional<Movement> best;
  for (const double share : {0.25, 0.5, 0.75}) {
    std::size_t split =
        std::clamp(static_cast<std::size_t>(share * static_cast<double>(seen.size())), kMinSeen,
                   seen.size() - kMinSeen);
    std::optional<TagPlacement> before;
    std::optional<TagPlacement> after;
    const auto fit_parts = [&] {
      before = judge.fit(id, false, 0, seen[split].first);
      after = judge.fit(id, false, seen[split].first);
      return before && after;
    };
    if (!fit_parts()) continue;
    // Moves the split to the frame from which the second placement fits better than the first.
    judge.measure(*before, id);
    judge.measure(*after, id);
    double sum = after->mean_px() * static_cast<double>(seen.size());
    double min_sum = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k + kMinSeen <= seen.size(); ++k) {
      if (k >= kMinSeen && sum < min_sum) {
        min_sum = sum;
        split = k;
      }
      sum += std::min(before->errors_px[k].second, kMaxSightingError_px) -
             std::min(after->errors_px[k].second, kMaxSightingError_px);
    }
    if (!fit_parts()) continue;
    const auto n = static_cast<double>(seen.size());
    Movement here;
    here.frame = seen[split].first;
    here.mean_px = (before->mean_px() * static_cast<double>(split) +
                    after->mean_px() * (n - static_cast<double>(split))) /
                   n;
    for (const Eigen::Vector3d& corner : tag_corners(size_m)) {
      here.distance_m = std::max(
          here.distance_m, (before->T_anchor_tag * corner - after->T_anchor_tag * corner).norm());
    }
    if (!best || here.mean_px < best->mean_px) best = here;
  }
  return best;
}

// Reason why a tag is inconsistent with the others.
struct Contradiction {
  std::string words;                  // "tag 7: looks ..."
  bool moved = false;                 // during the sweep
  std::optional<MappedTag> apparent;  // the tag with the size that fits; its pose is T_anchor_tag
};

std::optional<Contradiction> contradiction_of(const TagGraph& judge, const SurveyInput& input,
                                              int id, const SurveyOptions& options) {
  constexpr double kExplains = 0.5;  // maximum ratio of the errors with and without the explanation
  const bool sized = input.without_size.count(id) == 0;
  const double nominal_m = options.size_m(sized ? id : options.anchor);
  const auto any_size_fit = judge.fit(id, true);
  const auto given_size_fit = sized ? judge.fit(id, false) : any_size_fit;
  if (!any_size_fit || !given_size_fit) return std::nullopt;
  const auto moved = movement_of(judge, id, nominal_m);
  Contradiction result;
  if (!sized || (any_size_fit->mean_px() < kExplains * given_size_fit->mean_px() &&
                 (!moved || any_size_fit->mean_px() < 1.5 * moved->mean_px))) {
    const double size_m = any_size_fit->scale * nominal_m;
    result.apparent = MappedTag{id, options.family, size_m, any_size_fit->T_anchor_tag};
    result.words =
        sized ? fmt::format(
                    "tag {}: appears to be {:.1f} mm in size, but {:.1f} mm is given; give its "
                    "size with "
                    "--sizes",
                    id, size_m * 1e3, nominal_m * 1e3)
              : fmt::format(
                    "tag {}: has no size, and appears to be {:.1f} mm; give its size with --sizes",
                    id, size_m * 1e3);
    return result;
  }
  if (moved && moved->mean_px < kExplains * given_size_fit->mean_px()) {
    result.moved = true;
    result.words = fmt::format(
        "tag {}: moved by {:.1f} mm at about frame {}; sweep again while all of them rest", id,
        moved->distance_m * 1e3, input.of[moved->frame]);
    return result;
  }
  result.words = fmt::format(
      "tag {}: is {:.1f} px off from where the other tags put it; is it flat, and did it rest?", id,
      given_size_fit->mean_px());
  return result;
}

// The consistent tags, and for each inconsistent tag the reason.
struct Agreement {
  AdjustedGraph settled;
  std::map<int, Contradiction> others;
};

// Rejects inconsistent tags one by one, worst first.
Result<Agreement> agree(const CameraModel& camera, const SurveyInput& input, int anchor,
                        const SurveyOptions& options) {
  constexpr double kMaxLost = 0.5;     // maximum fraction of outlier sightings of a tag
  constexpr double kSuspicious = 0.1;  // smaller fractions may be caused by blur or occlusion
  std::set<int> without;
  for (;;) {
    auto settled = settle(camera, input, anchor, without, options);
    if (options.stop.stop_requested()) return fail("ended early");
    if (!settled) return tl::unexpected(settled.error());
    TagGraph judge = settled->graph;
    judge.frames = input.frames;
    std::optional<std::pair<double, int>> worst;
    for (const auto& [id, lost] : settled->lost) {
      if (id != anchor && lost > kMaxLost && (!worst || lost > worst->first)) worst = {lost, id};
    }
    for (const auto& [id, lost] : settled->lost) {
      if (worst || lost <= kSuspicious) continue;
      const auto reported = contradiction_of(judge, input, id, options);
      if (!reported || !reported->moved) continue;
      if (id == anchor) return fail("the anchor, {}", reported->words);
      worst = {lost, id};
    }
    if (worst) {
      without.insert(worst->second);
      continue;
    }
    Agreement result{std::move(*settled), {}};
    std::set<int> rejected = result.settled.misfits;
    rejected.insert(input.without_size.begin(), input.without_size.end());
    for (const int id : rejected) {
      if (auto reported = contradiction_of(judge, input, id, options))
        result.others[id] = std::move(*reported);
    }
    return result;
  }
}

struct LensAgreement {
  Agreement agreement;
  double lens_gain = 0.0;
};

// Solves for the lens as well, if that gives a better lens than the given one. Tries the
// uncertainty of the camera file first, then that of another focus.
Result<LensAgreement> agree_on_lens(const CameraModel& camera, SurveyInput input,
                                    const SurveyOptions& options) {
  PENUMBRA_TRY(auto with_given_lens, agree(camera, input, options.anchor, options));
  LensAgreement result{std::move(with_given_lens), 0.0};
  if (!options.refine_camera) return result;
  for (const Eigen::MatrixXd& prior :
       {lens_prior_of(camera, options.lens_sigmas), typical_lens_prior(camera)}) {
    if (prior.size() == 0) continue;
    input.lens_prior = prior;
    auto refined = agree(camera, input, options.anchor, options);
    if (options.stop.stop_requested()) return fail("ended early");
    if (!refined) continue;
    const TagGraph& graph = refined->settled.graph;
    if (!is_better_lens(graph, result.agreement.settled.graph.lens_prior)) continue;
    result.lens_gain = lens_gain(graph, {});
    result.agreement = std::move(*refined);
  }
  return result;
}

// Returns true if the anchor may be wrong, because too many tags are inconsistent with it.
bool anchor_is_doubtful(const Agreement& agreement, const SurveyInput& input, int anchor) {
  const auto lost = agreement.settled.lost.find(anchor);
  if (lost != agreement.settled.lost.end() && lost->second > 0.5) return true;
  const std::size_t misfits = agreement.settled.misfits.size();
  return misfits >= 2 && 2 * misfits > input.seen.size() - 1;
}

// Explains a doubtful anchor by surveys with other anchors.
tl::unexpected<Error> doubtful_anchor_error(const CameraModel& camera, const SurveyInput& input,
                                            const SurveyOptions& options) {
  std::vector<std::pair<int, int>> by_count;  // most sightings first
  for (const auto& [id, count] : input.seen) {
    if (id != options.anchor) by_count.emplace_back(-count, id);
  }
  std::ranges::sort(by_count);
  for (const auto& [count, other] : by_count | std::views::take(3)) {
    const auto agreement = agree(camera, input, other, options);
    if (!agreement || anchor_is_doubtful(*agreement, input, other)) continue;
    const auto reported = agreement->others.find(options.anchor);
    if (reported == agreement->others.end()) continue;
    return fail("the anchor, {}; or choose another anchor", reported->second.words);
  }
  return fail(
      "the tags are inconsistent: did some of them move, are the sizes right, and is the camera's "
      "file of this camera?");
}

const SurveyedTag* find_tag(const TagSurvey& survey, int id) {
  const auto found = std::ranges::find(survey.tags, id, [](const auto& tag) { return tag.tag.id; });
  return found == survey.tags.end() ? nullptr : &*found;
}

// Adds the rejected tags with the reasons.
void explain_left_out(TagSurvey& survey, const Agreement& agreement, const SurveyInput& input,
                      int anchor) {
  const TagPose& anchor_pose = find_tag(survey, anchor)->tag.T_table_tag;
  const Transform<frame::Table, frame::Table> table_from_anchor(anchor_pose.rotation(),
                                                                anchor_pose.translation());
  std::set<int> ids = input.without_size;
  for (const auto& [id, count] : input.seen) {
    if (find_tag(survey, id) == nullptr) ids.insert(id);
  }
  for (const int id : ids) {
    const auto reported = agreement.others.find(id);
    if (reported != agreement.others.end()) {
      survey.left_out.push_back(reported->second.words);
      if (!reported->second.apparent) continue;
      MappedTag& misfit = survey.misfits.emplace_back(*reported->second.apparent);
      misfit.T_table_tag = table_from_anchor * misfit.T_table_tag;
    } else if (input.without_size.count(id) > 0) {
      survey.left_out.push_back(fmt::format("tag {}: has no size", id));
    } else {
      const int count = input.seen.at(id);
      survey.left_out.push_back(
          fmt::format("tag {}: seen in {} frame{}, not often enough with others that are placed",
                      id, count, count == 1 ? "" : "s"));
    }
  }
}

}  // namespace

Result<TagSurvey> survey_tags(const CameraModel& camera, std::span<const SurveyFrame> frames,
                              const SurveyOptions& options) {
  silence_solver();
  const SurveyInput input = input_of(camera, frames, options);
  if (input.seen.empty()) {
    return fail(
        "no tag of the family {} with a known size is seen{}; name the family (--family) "
        "and the sizes",
        to_string(options.family),
        input.without_size.empty()
            ? ""
            : fmt::format(" (without size: {})", joined(std::vector(input.without_size.begin(),
                                                                    input.without_size.end()))));
  }
  if (input.seen.count(options.anchor) == 0) {
    std::vector<int> ids;
    for (const auto& [id, count] : input.seen) ids.push_back(id);
    return fail("the anchor, tag {}, is never seen{}; choose one of {}", options.anchor,
                input.without_size.count(options.anchor) > 0 ? " with a size" : "", joined(ids));
  }
  PENUMBRA_TRY(auto agreed, agree_on_lens(camera, input, options));
  Agreement& agreement = agreed.agreement;
  if (anchor_is_doubtful(agreement, input, options.anchor))
    return doubtful_anchor_error(camera, input, options);
  TagGraph& graph = agreement.settled.graph;
  TagSurvey result;
  result.rms_px = agreement.settled.rms_px;
  if (result.rms_px > 3.0) {
    return fail(
        "the tags are inconsistent by {:.1f} px: did some of them move, are the sizes right, and "
        "is the camera's file of this camera?",
        result.rms_px);
  }
  PENUMBRA_TRY(const auto covariance, graph.covariance());
  PENUMBRA_TRY(result.camera, graph.camera());
  result.lens_covariance = covariance.lens;
  result.lens_prior = graph.lens_prior;
  result.lens_gain = agreed.lens_gain;
  result.covariance_inflation = covariance.covariance_inflation;
  result.edge_shift_px = graph.shift;
  result.cameras.resize(frames.size());
  for (std::size_t f = 0; f < graph.frames.size(); ++f) {
    if (!graph.cameras[f] || graph.frames[f].empty()) continue;
    ++result.frames_used;
    result.cameras[input.of[f]] =
        unpacked<frame::Camera, frame::Table>(*graph.cameras[f]).inverse();
  }
  std::map<int, TagPose> poses;
  for (const auto& [id, pose] : graph.tags) {
    poses[id] = unpacked<frame::Table, frame::Tag>(pose);
    SurveyedTag& tag = result.tags.emplace_back();
    tag.tag = {id, options.family, options.size_m(id), poses[id]};
    tag.frames = static_cast<int>(graph.sightings_of(id).size());
  }
  const std::vector<int> on_plane = tags_on_table(poses, options);
  transform_to_plane(result, poses, covariance, on_plane, options.anchor);
  set_curvatures(result, frames);
  set_corner_heights(result, on_plane);
  explain_left_out(result, agreement, input, options.anchor);
  return result;
}

SurveyFrame measured_frame(const TagSurvey& survey, std::size_t index, const SurveyFrame& frame,
                           ImageView luma) {
  SurveyFrame result = frame;
  result.measured.assign(frame.tags.size(), std::nullopt);
  if (index >= survey.cameras.size() || !survey.cameras[index]) return result;
  const auto T_camera_table = survey.cameras[index]->inverse();
  for (std::size_t i = 0; i < frame.tags.size(); ++i) {
    const int id = frame.tags[i].id;
    const SurveyedTag* placed = find_tag(survey, id);
    const auto misfit = std::ranges::find(survey.misfits, id, &MappedTag::id);
    if (placed == nullptr && misfit == survey.misfits.end()) continue;
    const MappedTag& tag = placed != nullptr ? placed->tag : *misfit;
    const auto pattern = TagPattern::make(tag.family, tag.id);
    if (!pattern) continue;
    result.measured[i] =
        measure_tag(luma, survey.camera, *pattern, tag, T_camera_table * tag.T_table_tag);
  }
  return result;
}

}  // namespace penumbra
