// A recording that plays as if it were a camera: at its own pace, over and over, and who is late
// loses frames. For trying things out and for tests.
#pragma once

#include <memory>
#include <optional>

#include "app/capture/live_source.hpp"
#include "app/recording/recording_source.hpp"

namespace penumbra {

// `fps`: another pace than the recorded one. A damaged frame is skipped and counted, as a camera's
// is.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_recording_feed(const Recording& recording,
                                                                      std::optional<double> fps);

}  // namespace penumbra
