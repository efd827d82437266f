// Requested settings of a camera, common to V4L2 and libcamera.
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace penumbra {

// An empty field leaves the camera's setting unchanged. Focus is always locked if possible, because
// refocusing invalidates the calibration.
struct CameraControls {
  std::optional<double> exposure_ms;
  bool auto_exposure = false;
  std::optional<double> gain;  // V4L2: in the camera's steps; libcamera: a factor
  std::optional<int> white_balance_k;
  bool auto_white_balance = false;
  std::optional<double> focus;  // V4L2: in the camera's steps; libcamera: dioptres
};

// The requested stream; the camera may grant another one.
struct RequestedSettings {
  int width = 640;    // [px]
  int height = 480;   // [px]
  double fps = 30.0;  // ignored if the camera's rate can't be set
  // grey, nv12, yu12, yuyv, mjpeg or rgb; empty: the cheapest format to read at that size and rate.
  std::optional<std::string> format;
  bool recording = false;  // prefers JPEG, because a recording stores it without encoding
  CameraControls controls;
};

// Range of values that a control accepts, in the unit of its command-line option.
struct ControlRange {
  double lowest = 0.0;
  double highest = 0.0;
};
// Returns "exposure: the camera gives 66.7 ms for 500 ms; it takes 0.06 to 66.7 ms". `unit`: with a
// leading space, or empty. `range`: nullopt if unknown.
[[nodiscard]] std::string changed_control_text(std::string_view name, std::string_view unit,
                                               double requested, double given,
                                               const std::optional<ControlRange>& range);

struct GrantedControl {
  double value = 0.0;
  std::optional<std::string> warning;  // set if the value differs from the requested one
};
// Clamps a requested value to the control's range. A range that is empty, zero or not finite counts
// as unknown.
[[nodiscard]] GrantedControl granted_control(std::string_view name, std::string_view unit,
                                             double requested, const ControlRange& range);

}  // namespace penumbra
