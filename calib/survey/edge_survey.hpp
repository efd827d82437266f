// Surveys tags by their edges, which are more accurate than detected corners.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "calib/survey/tag_survey.hpp"
#include "core/error.hpp"

namespace penumbra {

// Surveys the frames (survey_tags()).
using RunSurvey = std::function<Result<TagSurvey>(std::span<const SurveyFrame>)>;
// Measures the edges of all frames' tags at the surveyed poses (measured_frame()).
using MeasureFrames = std::function<Result<void>(const TagSurvey&, std::vector<SurveyFrame>&)>;

// Surveys detected tags, then measures their edges at the surveyed poses, on paper with the
// surveyed curvature, and surveys again. Repeats this while tags are rejected or the curvature
// changes, up to four times. `frames` then has the measured edges.
[[nodiscard]] Result<TagSurvey> survey_by_edges(std::vector<SurveyFrame>& frames,
                                                const RunSurvey& survey,
                                                const MeasureFrames& measure);

}  // namespace penumbra
