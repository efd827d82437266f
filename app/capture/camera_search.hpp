// Which of the cameras that are there is the one that was lost.
#pragma once

#include <cstddef>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>

#include "app/capture/v4l2/v4l2_device.hpp"

namespace penumbra {

// Two cameras of one make tell themselves apart by their place on the bus only, and each has its
// own calibration. So: the one in the old place; or, in a new place, the one of its make that came
// since it was lost, if there is just one such.
class CameraSearch {
 public:
  explicit CameraSearch(V4l2Identity lost) : lost_(std::move(lost)) {}

  [[nodiscard]] bool is_in_place(const V4l2Identity& camera) const {
    return is_of_make(camera) && camera.bus == lost_.bus;
  }
  // The camera was lost just now.
  void begin();
  // Its index among the cameras that are there now. Those of its make that the first look after
  // begin() finds elsewhere were there before it was lost: others.
  [[nodiscard]] std::optional<std::size_t> find(std::span<const V4l2Identity> there);

 private:
  [[nodiscard]] bool is_of_make(const V4l2Identity& camera) const {
    return camera.card == lost_.card && camera.driver == lost_.driver;
  }

  V4l2Identity lost_;  // in the place where it was last
  bool first_look_ = true;
  std::set<std::string> others_;  // where on the bus
};

}  // namespace penumbra
