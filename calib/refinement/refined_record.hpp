// Record of a camera file whose lens or row time was refined by a tag survey.
#pragma once

#include <optional>
#include <string>

#include "calib/survey/row_time.hpp"
#include "calib/survey/tag_survey.hpp"
#include "core/camera/camera_file.hpp"

namespace penumbra {

// Keeps what still holds of the given camera's record. `row_time`: set if it was estimated;
// `target`: what the lens was refined on. Returns nullopt if nothing is known.
[[nodiscard]] std::optional<CalibrationRecord> refined_record(
    const TagSurvey& survey, const std::optional<RowTime>& row_time,
    const std::optional<CalibrationRecord>& given, const std::string& target);

}  // namespace penumbra
