// Writes a calibration report as one self-contained HTML file: the verdict, then its evidence.
#pragma once

#include <optional>
#include <string>

#include "calib/camera_calibration.hpp"

namespace penumbra {

struct ReportInput {
  std::string title;                   // source of the images
  std::string date;                    // "2026-03-01"
  std::string target;                  // Target::description
  std::optional<CameraModel> earlier;  // calibration to compare with, for the same image size
  std::string earlier_name;
};

[[nodiscard]] std::string calibration_report(const CameraCalibration& calibration,
                                             const ReportInput& input);

}  // namespace penumbra
