// Augments a camera: capture, tracking and drawing each have a thread. The newest frame is drawn
// with its own pose.
#pragma once

#include <filesystem>
#include <optional>

#include "app/live/live_camera.hpp"
#include "app/report/run_report.hpp"
#include "app/session/run_request.hpp"
#include "core/error.hpp"

namespace penumbra {

// threads: 1 tracks and draws one frame after the other; the camera always has a thread.
struct LiveRequest : RunRequest {
  CameraRequest camera;
  std::filesystem::path tags;
  std::optional<std::filesystem::path> record;
  std::optional<double> duration_s;  // from the first frame; default: no limit
  bool vsync = true;
};

// Ends after the duration, by Ctrl-C, or when the window is closed; the files are complete then.
[[nodiscard]] Result<RunReport> run_live(const LiveRequest& request);

}  // namespace penumbra
