// How a person wants a camera to be, whatever library opens it.
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace penumbra {

// What a person sets; nothing: as the camera is. Focus is always locked where it can be: a lens
// that moves is another camera model.
struct CameraControls {
  std::optional<double> exposure_ms;
  bool auto_exposure = false;
  std::optional<double> gain;  // in the camera's own steps; times by libcamera
  std::optional<int> white_balance_k;
  bool auto_white_balance = false;
  std::optional<double> focus;  // in the camera's own steps; dioptres by libcamera
};

// The stream that a person wishes for; what the camera grants is obeyed.
struct RequestedSettings {
  int width = 640;    // [px]
  int height = 480;   // [px]
  double fps = 30.0;  // where the rate can be set at all
  // grey, nv12, yu12, yuyv or mjpeg; nothing: the one that costs least at that size and rate.
  std::optional<std::string> format;
  // JPEGs are written to disk as they come, others have to be coded: they cost more then.
  bool recording = false;
  CameraControls controls;
};

// Values that a control takes, in the unit of its option.
struct ControlRange {
  double lowest = 0.0;
  double highest = 0.0;
};
struct GrantedControl {
  double value = 0.0;
  std::optional<std::string> warning;  // where the value is not the requested one
};
// Clamps a requested value to the control's range. `unit`: with a blank before it, or empty. A
// range that is empty, zero or not finite counts as unknown.
[[nodiscard]] GrantedControl granted_control(std::string_view name, std::string_view unit,
                                             double requested, const ControlRange& range);

}  // namespace penumbra
