// Names of the tracking modes, for names and messages of tests.
#pragma once

#include <string_view>

#include "tracking/tracker_options.hpp"

namespace penumbra {

[[nodiscard]] inline std::string_view to_string(TrackingMode mode) {
  for (const std::string_view name : {"detect", "fast", "accurate"}) {
    if (tracking_mode_from_string(name) == mode) return name;
  }
  return "auto";
}

}  // namespace penumbra
