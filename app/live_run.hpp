// A camera, augmented: capture, tracking and drawing each on a thread of its own, always with the
// newest frame, and always with the pose that belongs to it.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "app/capture/camera_controls.hpp"
#include "app/capture/live_source.hpp"
#include "app/run_outputs.hpp"
#include "app/run_report.hpp"
#include "app/viewer.hpp"
#include "core/error.hpp"
#include "render/frame_plan.hpp"
#include "tracking/table_tracker.hpp"

namespace penumbra {

struct LiveRequest : OutputRequest {
  std::string camera = "v4l2:/dev/video0";  // or libcamera:NAME, recording:FOLDER
  std::filesystem::path calibration;
  std::filesystem::path tags;
  std::filesystem::path scene;
  PlanOptions plan;
  std::optional<std::filesystem::path> kernel_file;  // for the scene's casters that it fits
  TrackerOptions tracking;
  std::optional<int> width, height;  // [px]; the calibration's
  std::optional<double> fps;
  std::optional<std::string> format;  // of V4L2
  CameraControls controls;
  std::optional<std::filesystem::path> record;
  std::optional<double> duration_s;  // from the first frame; nothing: until it is stopped
  bool window = true;                // where there is a display
  bool vsync = true;
  ViewerOptions viewer;
};

// Ends after the duration, by Ctrl-C, or when the window is closed; the files hold everything up to
// then.
[[nodiscard]] Result<RunReport> run_live(const LiveRequest& request);

// The camera that the request names, at the size of its calibration.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_live_source(const LiveRequest& request,
                                                                   const CameraModel& camera);

}  // namespace penumbra
