#include "tracking/tag_consensus.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace penumbra {
namespace {

// Returns the number of clearly visible tags that do not fit the pose.
int inconsistent_tags(const AlignmentResult& result, std::span<const TagObservation> detected) {
  int count = 0;
  for (const TagAlignment& tag : result.tags) {
    if (tag.verified) continue;
    const bool seen =
        std::ranges::find(detected, tag.index, &TagObservation::index) != detected.end();
    count += tag.inconsistent || seen ? 1 : 0;
  }
  return count;
}

// Returns the RMS displacement of tags that are aligned alone instead of jointly [px].
double scatter_px(const RigidTags& group, const Alignment& joint) {
  const MapFromCamera& pose = joint.result.T_map_camera;
  Alignment alone{joint.aligner, joint.input, false};
  alone.input.predicted = pose;
  alone.input.covariance = uninformative_covariance();
  double sum = 0.0;
  double count = 0.0;
  for (const TagAlignment& tag : joint.result.tags) {
    std::vector<int> others;
    for (int i = 0; i < static_cast<int>(group.tags.size()); ++i) {
      if (i != tag.index) others.push_back(i);
    }
    alone.run_without(others);
    const AlignmentResult& own = alone.result;
    if (!own.verified || !own.T_map_camera.is_finite()) continue;
    const auto centre = group[tag.index].T_table_tag.translation();
    const auto pixel = group.camera.project(pose.inverse() * centre);
    const auto own_pixel = group.camera.project(own.T_map_camera.inverse() * centre);
    if (!pixel || !own_pixel) continue;
    sum += (*pixel - *own_pixel).squaredNorm();
    count += 1.0;
  }
  return count > 0.0 ? std::sqrt(sum / count) : 0.0;
}

}  // namespace

void TagConsensus::begin(std::vector<int> rejected) {
  rejected_ = std::move(rejected);
  frames_rejected_ = 0;
}

void TagConsensus::begin_strict_frames() {
  constexpr int kStrictFrames = 5;
  strict_frames_ = kStrictFrames;
}

void TagConsensus::count_strict_frame() {
  strict_frames_ = std::max(strict_frames_ - 1, 0);
}

// A small majority may consist of moved tags and one or two others that fit by chance.
bool TagConsensus::may_reject(const AlignmentResult& result) const {
  return 3 * (rejected_.size() + 1) <=
         rejected_.size() + static_cast<std::size_t>(result.counters.tags_visible);
}

// Returns true if the tags that fit do not clearly outnumber the others: two or three may fit by
// chance. In strict frames, most tags in the image must fit.
bool TagConsensus::lacks_majority(std::span<const TagObservation> detected,
                                  const Alignment& alignment) const {
  const AlignmentResult& result = alignment.result;
  if (!result.verified) return false;
  if (alignment.with_search) return many_are_inconsistent(result);
  if (result.tags_verified < 2 * inconsistent_tags(result, detected)) return true;
  constexpr double kStrict_px = 0.15;  // one tag may have biased the pose of the others
  return strict_frames_ > 0 && (3 * result.tags_verified < 2 * result.counters.tags_in_image ||
                                (result.disagreement >= kInconsistentDisagreement &&
                                 result.displacement_px >= kStrict_px));
}

// Rejects the tag whose removal makes all others agree. Tests each candidate from the pose by the
// others' corners, because a pose that was fitted to the wrong tag may be a local minimum.
void TagConsensus::reject_one(const RigidTags& group, std::span<const TagObservation> detected,
                              Alignment& alignment) {
  constexpr std::size_t kMaxTries = 6;
  constexpr double kAgree = 3.0;
  const AlignmentResult& result = alignment.result;
  if (result.counters.tags_visible < 4 || !may_reject(result)) return;
  std::vector<TagAlignment> candidates = result.tags;
  std::ranges::stable_sort(candidates, {}, &TagAlignment::weight_share);
  candidates.resize(std::min(candidates.size(), kMaxTries));
  double best_disagreement = kAgree;
  int outlier = -1;
  MapFromCamera best_start = alignment.input.predicted;
  for (const TagAlignment& candidate : candidates) {
    std::vector<int> without = rejected_;
    without.push_back(candidate.index);
    std::vector<TagObservation> others;
    for (const TagObservation& seen : detected) {
      if (std::ranges::find(without, seen.index) == without.end()) others.push_back(seen);
    }
    const auto start = estimate_board_pose(group.camera, others);
    if (!start || start->inconsistent || !start->best.T_map_camera.is_finite()) continue;
    alignment.input.predicted = start->best.T_map_camera;
    const AlignmentResult others_only = alignment.tried_without(without);
    if (!others_only.verified || others_only.tags_verified < others_only.counters.tags_in_image ||
        !(others_only.disagreement < best_disagreement))
      continue;
    best_disagreement = others_only.disagreement;
    outlier = candidate.index;
    best_start = alignment.input.predicted;
  }
  alignment.input.predicted = best_start;
  if (outlier >= 0) {
    rejected_.push_back(outlier);
    frames_rejected_ = 0;
  }
  alignment.run_without(rejected_);
}

bool TagConsensus::settle(const RigidTags& group, std::span<const TagObservation> detected,
                          Alignment& alignment) {
  const AlignmentResult& result = alignment.result;
  while (result.verified && result.inconsistent_tag >= 0) {
    if (!may_reject(result)) return false;
    rejected_.push_back(result.inconsistent_tag);
    frames_rejected_ = 0;
    alignment.run_without(rejected_);
  }
  const bool no_majority = lacks_majority(detected, alignment);
  if (!result.verified || (result.disagreement < kInconsistentDisagreement && !no_majority))
    return true;
  if (!alignment.with_search) reject_one(group, detected, alignment);
  if (no_majority && lacks_majority(detected, alignment)) return false;
  // Only some of the visible tags fit.
  if (result.verified && result.disagreement >= kInconsistentDisagreement &&
      3 * result.tags_verified < 2 * result.counters.tags_visible)
    return false;
  // Maximum displacements by lens, camera response and paper [px].
  constexpr double kSuspicious_px = 0.3;  // RMS over tags aligned jointly
  constexpr double kElsewhere_px = 0.5;   // RMS over tags aligned one by one
  if (!result.verified || result.disagreement < kInconsistentDisagreement ||
      result.displacement_px < kSuspicious_px)
    return true;
  constexpr int kInterval_frames = 15;  // [frames]
  if (alignment.with_search && frames_untested_++ % kInterval_frames != 0) return true;
  const double apart_px = scatter_px(group, alignment);
  alignment.run_without(rejected_);
  return apart_px < kElsewhere_px;
}

void TagConsensus::retest_rejected_seldom(Alignment& alignment) {
  constexpr int kInterval_frames = 60;  // [frames]
  if (!rejected_.empty() && ++frames_rejected_ >= kInterval_frames) retest_rejected(alignment);
}

void TagConsensus::retest_rejected(Alignment& alignment) {
  const AlignmentResult& result = alignment.result;
  if (rejected_.empty() || !result.verified) return;
  frames_rejected_ = 0;
  const double without_it = result.disagreement;
  for (std::size_t i = 0; i < rejected_.size(); ++i) {
    std::vector<int> fewer = rejected_;
    const int tag = fewer[i];
    fewer.erase(fewer.begin() + static_cast<std::ptrdiff_t>(i));
    const AlignmentResult all = alignment.tried_without(fewer);
    const auto it = std::ranges::find(all.tags, tag, &TagAlignment::index);
    const bool agrees =
        all.verified && it != all.tags.end() && it->verified &&
        all.disagreement < std::max(kInconsistentDisagreement / 2.0, 1.5 * without_it);
    if (!agrees) continue;
    rejected_ = fewer;
    break;
  }
  alignment.run_without(rejected_);
}

}  // namespace penumbra
