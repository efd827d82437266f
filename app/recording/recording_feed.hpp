// A recording played as a camera: at its own rate, in a loop, and a slow reader loses frames. For
// trials and tests.
#pragma once

#include <memory>
#include <optional>

#include "app/capture/live_source.hpp"
#include "app/recording/recording_source.hpp"

namespace penumbra {

// `fps`: replaces the recorded rate. Damaged frames are skipped and counted, as a camera's are.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_recording_feed(const Recording& recording,
                                                                      std::optional<double> fps);

}  // namespace penumbra
