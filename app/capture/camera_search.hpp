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

// Cameras of one model differ only by their place on the bus, and each has its own calibration. So
// the camera in the old place is the lost one; or, in a new place, the only one of its model that
// was connected since.
class CameraSearch {
 public:
  explicit CameraSearch(V4l2Identity lost) : lost_(std::move(lost)) {}

  [[nodiscard]] bool is_in_place(const V4l2Identity& camera) const {
    return is_of_model(camera) && camera.bus == lost_.bus;
  }
  // The camera was lost just now.
  void begin();
  // Index of the lost camera among the connected ones. Cameras of its model that the first call
  // after begin() finds in other places are other cameras.
  [[nodiscard]] std::optional<std::size_t> find(std::span<const V4l2Identity> connected);

 private:
  [[nodiscard]] bool is_of_model(const V4l2Identity& camera) const {
    return camera.card == lost_.card && camera.driver == lost_.driver;
  }

  V4l2Identity lost_;  // with its last place
  bool first_look_ = true;
  std::set<std::string> others_;  // their places on the bus
};

}  // namespace penumbra
