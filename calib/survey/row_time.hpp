// Rolling shutter of a tag survey: estimates the row time, and corrects the corners of moving
// frames (docs/calibration.md#row-time).
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "calib/survey/tag_survey.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "tracking/evaluation/residual_causes.hpp"

namespace penumbra {

struct RowTime {
  double seconds = 0.0;  // from the read-out of one row to that of the next
  double sigma_s = 0.0;
};

[[nodiscard]] Result<CameraModel> with_row_time(const CameraModel& camera, double row_s);

// Returns the row time that the residuals of corners show, if they show another one than the
// camera's, or one at all. `causes`: of residuals with the row time of `camera`. `was_found`: as
// below.
[[nodiscard]] std::optional<RowTime> row_time_of(const CameraModel& camera,
                                                 const ResidualCauses& causes,
                                                 bool was_found = false);

// Estimates the row time from the uncorrected corners of `frames`. `survey` must be corrected for
// the row time of `camera`, if it has one. Returns nullopt if the corners do not show another row
// time, or none at all. `was_found`: the row time of `camera` is an estimate from the same frames;
// it is improved in any case.
[[nodiscard]] std::optional<RowTime> find_row_time(const CameraModel& camera,
                                                   const TagSurvey& survey,
                                                   std::span<const SurveyFrame> frames,
                                                   bool was_found = false);

// Returns the frames with the corners that the camera would show if it exposed all rows at the time
// of the middle row. `camera`: has the row time. `survey`: approximate poses.
[[nodiscard]] std::vector<SurveyFrame> at_middle_row(const CameraModel& camera,
                                                     const TagSurvey& survey,
                                                     std::span<const SurveyFrame> frames);
// The same for one frame of tags at known places. `frame`: approximate pose and velocity. Returns
// nullopt if the corners do not determine the motion.
[[nodiscard]] std::optional<FrameCorners> at_middle_row(const CameraModel& camera,
                                                        std::span<const MappedTag> tags,
                                                        FrameCorners frame);

}  // namespace penumbra
