// Plays a recording as a camera, in a loop and at the recorded rate; a slow reader loses frames.
// For trials and tests.
#pragma once

#include <memory>
#include <optional>

#include "app/capture/live_source.hpp"
#include "app/recording/recording_source.hpp"

namespace penumbra {

// `fps`: replaces the recorded rate. Damaged frames are skipped and counted like those of a camera.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_recording_feed(const Recording& recording,
                                                                      std::optional<double> fps);

}  // namespace penumbra
