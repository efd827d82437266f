// Names of the tracking modes, for names and messages of tests.
#pragma once

#include "tracking/tracker_options.hpp"

namespace penumbra {

[[nodiscard]] inline std::string_view to_string(TrackingMode mode) {
  return name_of(kTrackingModeNames, mode);
}

}  // namespace penumbra
