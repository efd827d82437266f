// How a person wants a camera to be, whatever library opens it.
#pragma once

#include <optional>

namespace penumbra {

// What a person sets; nothing: as the camera is. Focus is always locked where it can be: a lens
// that moves is another camera model.
struct CameraControls {
  std::optional<double> exposure_ms;
  bool auto_exposure = false;
  std::optional<int> gain;  // in the camera's own steps; times by libcamera
  std::optional<int> white_balance_k;
  bool auto_white_balance = false;
  std::optional<int> focus;  // in the camera's own steps; dioptres by libcamera
};

}  // namespace penumbra
