// Shape of the paper in a tag survey: curvature of each tag and heights over the table's plane.
#pragma once

#include <span>
#include <vector>

#include "calib/survey/tag_survey.hpp"

namespace penumbra {

// Sets the curvatures of the tags, if those from one half of the frames explain the other half
// better than flat paper does (docs/calibration.md#curved-paper).
void set_curvatures(TagSurvey& survey, std::span<const SurveyFrame> frames);

// Sets the heights of the corners of the tags on the table's plane. `on_plane`: their ids, sorted.
void set_corner_heights(TagSurvey& survey, const std::vector<int>& on_plane);

}  // namespace penumbra
