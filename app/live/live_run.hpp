// Augments the images of a live camera. Capture, tracking and drawing each have a thread. Each
// frame is drawn with the pose that was tracked in it.
#pragma once

#include <filesystem>
#include <optional>

#include "app/live/live_camera.hpp"
#include "app/recording/session_record.hpp"
#include "app/report/run_report.hpp"
#include "app/run/run_request.hpp"
#include "core/error.hpp"

namespace penumbra {

// `threads`: with 1, tracking and drawing alternate on one thread; the camera always has a thread.
struct LiveRequest : RunRequest {
  CameraRequest camera;
  std::filesystem::path tags;
  std::optional<std::filesystem::path> record;
  std::optional<double> duration_s;  // measured from the first frame; default: no limit
  bool vsync = true;
  std::optional<std::filesystem::path> configuration;  // a file that no output may replace
  GivenOptions kept_options;                           // that a recording keeps
};

// Ends after the duration, on Ctrl-C, or when the window is closed. All files are complete then.
[[nodiscard]] Result<RunReport> run_live(const LiveRequest& request);

}  // namespace penumbra
