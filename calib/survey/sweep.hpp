// Surveys a sweep over tags by their edges, with the row time and the lens of the camera.
#pragma once

#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "calib/survey/row_time.hpp"
#include "calib/survey/tag_survey.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"

namespace penumbra {

enum class RowTimeGoal {
  given,      // corrects the corners for the camera's row time, if it has one
  reported,   // also tests whether the corners show another one
  estimated,  // uses the one that the corners show
};

struct SweepGoals {
  RowTimeGoal row_time = RowTimeGoal::given;
  bool refine_camera = false;  // SurveyOptions::refine_camera
};

struct SweepSteps {
  // Surveys the frames (survey_tags()) with this camera; `refine_camera`: and its lens.
  std::function<Result<TagSurvey>(const CameraModel&, std::span<const SurveyFrame>,
                                  bool refine_camera)>
      survey;
  // Measures the edges of all frames' tags at the surveyed poses (measured_frame()).
  std::function<Result<void>(const TagSurvey&, std::vector<SurveyFrame>&)> measure;
};

struct SweptTags {
  TagSurvey survey;
  std::optional<RowTime> row_time;  // if one was found that differs from the camera's
};

// Surveys detected tags, then measures their edges at the surveyed poses, on paper with the
// surveyed curvature, and surveys again. Repeats this while tags are rejected or the curvature
// changes, up to four times. Then solves for the row time, and for the lens last, so that they do
// not compensate curved paper.
[[nodiscard]] Result<SweptTags> survey_sweep(const CameraModel& camera,
                                             std::vector<SurveyFrame> frames,
                                             const SweepSteps& steps, const SweepGoals& goals);

}  // namespace penumbra
