#include "calib/refinement/refined_record.hpp"

#include <fmt/chrono.h>

#include <ctime>

#include "calib/camera_calibration.hpp"
#include "calib/solver/table_volume.hpp"

namespace penumbra {

std::optional<CalibrationRecord> refined_record(const TagSurvey& survey,
                                                const std::optional<RowTime>& row_time,
                                                const std::optional<CalibrationRecord>& given,
                                                const std::string& target) {
  if (!survey.lens_is_refined()) {
    if (!row_time) return given;
    CalibrationRecord record = given.value_or(CalibrationRecord());
    record.row_time_sigma_s = row_time->sigma_s;
    return record;
  }
  CalibrationRecord record;
  if (given) {
    record.focus_position = given->focus_position;
    record.tone_curve_sigma = given->tone_curve_sigma;
    record.row_time_sigma_s = given->row_time_sigma_s;
  }
  const std::time_t now = std::time(nullptr);
  std::tm local{};
  record.calibrated_on = fmt::format("{:%Y-%m-%d}", *localtime_r(&now, &local));
  record.target = target;
  record.views = survey.frames_used;
  record.rms_px = survey.rms_px;
  if (row_time) record.row_time_sigma_s = row_time->sigma_s;
  const UncertaintyMap projection = uncertainty_map(survey.camera, survey.lens_covariance);
  record.projection_mean_px = projection.mean_px;
  record.projection_largest_px = projection.largest_px;
  if (const auto table = table_volume_uncertainty(survey.camera, survey.lens_covariance)) {
    record.table_distance_m = table->distance_m;
    record.table_tracked_px.assign(table->tracked_px.begin(), table->tracked_px.end());
    record.table_known_pose_px.assign(table->known_pose_px.begin(), table->known_pose_px.end());
  }
  const Eigen::VectorXd sigmas = survey.lens_covariance.diagonal().cwiseSqrt();
  record.standard_deviations.assign(sigmas.begin(), sigmas.end());
  return record;
}

}  // namespace penumbra
