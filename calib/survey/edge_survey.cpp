#include "calib/survey/edge_survey.hpp"

#include <algorithm>
#include <cmath>

#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr int kMaxRounds = 4;
constexpr double kMaxHeightChange_m = 2e-5;  // below the accuracy of edges

// Returns an upper bound of the height change that the new curvatures cause [m].
double largest_height_change(const TagSurvey& before, const TagSurvey& after) {
  double largest_m = 0.0;
  for (const SurveyedTag& tag : after.tags) {
    const auto same = std::ranges::find(before.tags, tag.tag.id,
                                        [](const SurveyedTag& other) { return other.tag.id; });
    if (same == before.tags.end()) continue;
    const TagCurvature& now = tag.tag.curvature;
    const TagCurvature& then = same->tag.curvature;
    const double half_m = 0.5 * tag.tag.size_m;
    const double change =
        std::abs(now.xx - then.xx) + 2.0 * std::abs(now.xy - then.xy) + std::abs(now.yy - then.yy);
    largest_m = std::max(largest_m, 0.5 * half_m * half_m * change);
  }
  return largest_m;
}

std::vector<int> ids_of(const TagSurvey& survey) {
  std::vector<int> ids;
  for (const SurveyedTag& tag : survey.tags) ids.push_back(tag.tag.id);
  return ids;
}

}  // namespace

Result<TagSurvey> survey_by_edges(std::vector<SurveyFrame>& frames, const RunSurvey& survey,
                                  const MeasureFrames& measure) {
  PENUMBRA_TRY(TagSurvey result, survey(frames));
  for (int round = 0; round < kMaxRounds; ++round) {
    const TagSurvey before = result;
    PENUMBRA_TRY_VOID(measure(result, frames));
    PENUMBRA_TRY(result, survey(frames));
    if (ids_of(result) == ids_of(before) &&
        largest_height_change(before, result) < kMaxHeightChange_m)
      break;
  }
  return result;
}

}  // namespace penumbra
