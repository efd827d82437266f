#include "calib/survey/sweep.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

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

bool rolls(const CameraModel& camera) {
  return camera.parameters().rolling_shutter_row_s.value_or(0.0) > 0.0;
}

Result<TagSurvey> survey_by_edges(const CameraModel& camera, std::vector<SurveyFrame>& frames,
                                  const SweepSteps& steps) {
  PENUMBRA_TRY(TagSurvey result, steps.survey(camera, frames, false));
  for (int round = 0; round < kMaxRounds; ++round) {
    const TagSurvey before = result;
    PENUMBRA_TRY_VOID(steps.measure(result, frames));
    PENUMBRA_TRY(result, steps.survey(camera, frames, false));
    if (ids_of(result) == ids_of(before) &&
        largest_height_change(before, result) < kMaxHeightChange_m)
      break;
  }
  return result;
}

// Frames that were measured, and the camera whose rows they are corrected for.
struct MeasuredSweep {
  CameraModel camera;
  std::vector<SurveyFrame> frames;
  std::vector<SurveyFrame> corrected;  // empty: not corrected

  [[nodiscard]] Result<TagSurvey> survey(const SweepSteps& steps, bool refine_camera) const {
    return steps.survey(camera, corrected.empty() ? frames : corrected, refine_camera);
  }
};

// Corrects the corners for the row time, and finds it if that is a goal. Repeats this, because
// corrections and row time depend on the map.
Result<SweptTags> correct_rows(MeasuredSweep& sweep, TagSurvey survey, const SweepSteps& steps,
                               RowTimeGoal goal) {
  const int rounds = goal == RowTimeGoal::given ? 1 : 5;
  SweptTags result{std::move(survey), std::nullopt};
  const auto correct = [&]() -> Result<void> {
    sweep.corrected = at_middle_row(sweep.camera, result.survey, sweep.frames);
    PENUMBRA_TRY(result.survey, sweep.survey(steps, false));
    return {};
  };
  if (rolls(sweep.camera)) PENUMBRA_TRY_VOID(correct());
  for (int round = 0; round < rounds; ++round) {
    if (goal != RowTimeGoal::given) {
      const bool was_found = round > 0 && result.row_time;
      if (const auto found = find_row_time(sweep.camera, result.survey, sweep.frames, was_found)) {
        result.row_time = found;
        if (goal == RowTimeGoal::estimated) {
          PENUMBRA_TRY(sweep.camera, with_row_time(sweep.camera, found->seconds));
        }
      }
    }
    if (!rolls(sweep.camera)) break;
    PENUMBRA_TRY_VOID(correct());
  }
  return result;
}

}  // namespace

Result<SweptTags> survey_sweep(const CameraModel& camera, std::vector<SurveyFrame> frames,
                               const SweepSteps& steps, const SweepGoals& goals) {
  PENUMBRA_TRY(TagSurvey first, survey_by_edges(camera, frames, steps));
  MeasuredSweep sweep{camera, std::move(frames), {}};
  PENUMBRA_TRY(SweptTags result, correct_rows(sweep, std::move(first), steps, goals.row_time));
  if (!goals.refine_camera) return result;
  PENUMBRA_TRY(result.survey, sweep.survey(steps, true));
  // With a rolling shutter the tags are not where the poses of the middle row show them.
  if (!result.survey.lens_is_refined() || rolls(sweep.camera)) return result;
  PENUMBRA_TRY_VOID(steps.measure(result.survey, sweep.frames));
  PENUMBRA_TRY(result.survey, sweep.survey(steps, true));
  return result;
}

}  // namespace penumbra
