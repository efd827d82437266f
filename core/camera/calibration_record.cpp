// Reads how a camera was calibrated from the keys that save_camera() writes.

#include <algorithm>
#include <array>

#include "core/camera/camera_file.hpp"
#include "core/propagate.hpp"
#include "core/text/yaml_fields.hpp"

namespace penumbra {
namespace {

constexpr const char* kRemedy = "leave out `uncertainty`, or calibrate again";

Result<void> read_table_volume(const YamlFields& uncertainty, CalibrationRecord& record) {
  if (!uncertainty.has("table_volume")) return {};
  PENUMBRA_TRY(const YamlFields table, uncertainty.fields("table_volume", kRemedy));
  PENUMBRA_TRY(record.table_tracked_px, table.numbers("tracked_px", kRemedy));
  if (table.has("known_pose_px")) {
    PENUMBRA_TRY(record.table_known_pose_px, table.numbers("known_pose_px", kRemedy));
  }
  PENUMBRA_TRY(const auto distance, table.optional_number("distance_m", kRemedy));
  record.table_distance_m = distance.value_or(0.0);
  return {};
}

Result<void> read_standard_deviations(const YamlFields& uncertainty, const CameraModel& camera,
                                      CalibrationRecord& record) {
  if (!uncertainty.has("standard_deviations")) return {};
  PENUMBRA_TRY(record.standard_deviations, uncertainty.numbers("standard_deviations", kRemedy));
  const auto count = static_cast<std::size_t>(4 + coefficient_count(camera.parameters().model));
  const std::string place = uncertainty.place_of("standard_deviations");
  if (record.standard_deviations.size() != count) {
    return fail("{}: has {} numbers, but this lens has {} parameters; {}", place,
                record.standard_deviations.size(), count, kRemedy);
  }
  constexpr double kMaxSigma = 1e6;
  for (const double sigma : record.standard_deviations) {
    if (!(sigma >= 0.0 && sigma <= kMaxSigma)) {
      return fail("{}: {} is not a standard deviation from 0 to {:g}; {}", place, sigma, kMaxSigma,
                  kRemedy);
    }
  }
  return {};
}

Result<void> read_uncertainty(const YamlFields& uncertainty, const CameraModel& camera,
                              CalibrationRecord& record) {
  if (uncertainty.has("target")) {
    PENUMBRA_TRY(record.target, uncertainty.text("target", kRemedy));
  }
  if (uncertainty.has("views")) {
    PENUMBRA_TRY(record.views, uncertainty.integer("views", kRemedy));
  }
  const auto read = [&](const char* key, double& value) -> Result<void> {
    PENUMBRA_TRY(const auto number, uncertainty.optional_number(key, kRemedy));
    value = number.value_or(CalibrationRecord::kUnknown);
    return {};
  };
  PENUMBRA_TRY_VOID(read("rms_px", record.rms_px));
  PENUMBRA_TRY_VOID(read("projection_mean_px", record.projection_mean_px));
  PENUMBRA_TRY_VOID(read("projection_largest_px", record.projection_largest_px));
  PENUMBRA_TRY(record.held_out_px, uncertainty.optional_number("held_out_px", kRemedy));
  PENUMBRA_TRY(record.tone_curve_sigma, uncertainty.optional_number("tone_curve", kRemedy));
  PENUMBRA_TRY(record.row_time_sigma_s,
               uncertainty.optional_number("rolling_shutter_row_s", kRemedy));
  PENUMBRA_TRY_VOID(read_table_volume(uncertainty, record));
  return read_standard_deviations(uncertainty, camera, record);
}

}  // namespace

Result<std::optional<CalibrationRecord>> load_calibration_record(const std::filesystem::path& file,
                                                                 const CameraModel& camera) {
  if (!load_yaml_map(file)) return std::nullopt;  // for example OpenCV's XML
  using Record = std::optional<CalibrationRecord>;
  return read_yaml_map(file, "a camera file", [&](const YAML::Node& root) -> Result<Record> {
    const YamlFields fields(root, file.string());
    constexpr std::array kKeys = {"calibrated_on", "focus_position", "uncertainty"};
    if (std::ranges::none_of(kKeys, [&](const char* key) { return fields.has(key); }))
      return std::nullopt;
    CalibrationRecord record;
    if (fields.has("calibrated_on")) {
      PENUMBRA_TRY(record.calibrated_on,
                   fields.text("calibrated_on", "give a date, or leave it out"));
    }
    PENUMBRA_TRY(record.focus_position,
                 fields.optional_number("focus_position", "give a number, or leave it out"));
    if (fields.has("uncertainty")) {
      PENUMBRA_TRY(const YamlFields uncertainty, fields.fields("uncertainty", kRemedy));
      PENUMBRA_TRY_VOID(read_uncertainty(uncertainty, camera, record));
    }
    return record;
  });
}

}  // namespace penumbra
