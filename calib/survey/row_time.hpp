// Rolling shutter of a tag survey: estimates the row time, and corrects the corners of moving
// frames (docs/calibration.md#row-time).
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "calib/survey/tag_survey.hpp"
#include "core/camera/camera_model.hpp"

namespace penumbra {

struct RowTime {
  double seconds = 0.0;  // from the read-out of one row to that of the next
  double sigma_s = 0.0;
};

// Estimates the row time from the uncorrected corners of `frames`. `camera`: has the row time that
// `survey` is corrected for; without one, returns nullopt if the corners do not show a row time.
[[nodiscard]] std::optional<RowTime> find_row_time(const CameraModel& camera,
                                                   const TagSurvey& survey,
                                                   std::span<const SurveyFrame> frames);

// Returns the frames with the corners that the camera would show if it exposed all rows at the time
// of the middle row. `camera`: has the row time. `survey`: approximate poses.
[[nodiscard]] std::vector<SurveyFrame> at_middle_row(const CameraModel& camera,
                                                     const TagSurvey& survey,
                                                     std::span<const SurveyFrame> frames);

}  // namespace penumbra
