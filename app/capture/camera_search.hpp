// Recognises a lost camera among the connected ones.
#pragma once

#include <cstddef>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>

#include "app/capture/v4l2/v4l2_device.hpp"

namespace penumbra {

// Cameras of one model differ only by their bus address (USB port), but each has its own
// calibration. The lost camera is therefore the camera at the old address. If no camera is there,
// it is the only camera of its model that was connected at another address after the loss.
class CameraSearch {
 public:
  explicit CameraSearch(V4l2Identity lost) : lost_(std::move(lost)) {}

  [[nodiscard]] bool is_at_known_address(const V4l2Identity& camera) const {
    return is_of_model(camera) && camera.bus == lost_.bus;
  }
  // Call this when the camera is lost.
  void begin();
  // Returns the index of the lost camera among the connected ones, or nullopt. Cameras of its model
  // that the first call after begin() finds at other addresses are excluded from then on.
  [[nodiscard]] std::optional<std::size_t> find(std::span<const V4l2Identity> connected);

 private:
  [[nodiscard]] bool is_of_model(const V4l2Identity& camera) const {
    return camera.card == lost_.card && camera.driver == lost_.driver;
  }

  V4l2Identity lost_;  // includes the latest bus address
  bool first_search_ = true;
  std::set<std::string> excluded_buses_;  // bus addresses of the excluded cameras
};

}  // namespace penumbra
