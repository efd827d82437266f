// A camera, augmented: capture, tracking and drawing each on a thread of its own, always with the
// newest frame, and always with the pose that belongs to it.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "app/capture/camera_controls.hpp"
#include "app/capture/live_source.hpp"
#include "app/output/run_outputs.hpp"
#include "app/report/run_report.hpp"
#include "app/window/viewer.hpp"
#include "core/error.hpp"
#include "render/frame_plan.hpp"
#include "tracking/table_tracker.hpp"

namespace penumbra {

struct LiveRequest : OutputRequest {
  std::string camera = "v4l2:/dev/video0";  // or libcamera:NAME, recording:FOLDER
  std::filesystem::path calibration;
  std::string camera_name;  // of a calibration with several cameras
  std::filesystem::path tags;
  std::filesystem::path scene;
  PlanOptions plan;
  bool rectified = false;   // the picture without the lens's distortion
  std::optional<int> msaa;  // as CompositorOptions'
  std::optional<bool> pixel_buffers;
  bool video_light = true;                           // virtual objects are lit as the video is
  std::optional<std::filesystem::path> kernel_file;  // for the scene's casters that it fits
  TrackerOptions tracking;
  std::optional<int> width, height;  // [px]; the calibration's
  // Where the pictures have another size than the calibration, it is scaled if it can be exactly;
  // that both show the same view is the caller's word.
  bool scale_calibration = false;
  std::optional<double> fps;
  std::optional<std::string> format;  // of V4L2
  CameraControls controls;
  bool dma_buf = true;  // V4L2 buffers are shared with the GPU, where that is possible
  std::optional<std::filesystem::path> record;
  std::optional<double> duration_s;  // from the first frame; nothing: until it is stopped
  bool smooth = false;               // the pose that is drawn
  bool window = true;                // where there is a display
  bool vsync = true;
  // 1: frames are tracked and drawn one after the other; more: side by side. The camera has a
  // thread of its own in any case.
  int threads = 2;
  ViewerOptions viewer;
};

// Ends after the duration, by Ctrl-C, or when the window is closed; the files hold everything up to
// then.
[[nodiscard]] Result<RunReport> run_live(const LiveRequest& request);

// The camera that the request names, at the size of its calibration.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_live_source(const LiveRequest& request,
                                                                   const CameraModel& camera);

// The same without a calibration, at the size that the request names or that a camera has first.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_live_source(const LiveRequest& request);
// What to say where the camera's lens is focused elsewhere than when it was calibrated: it is
// another lens then. Nothing where it is not, or either does not say.
[[nodiscard]] std::optional<std::string> focus_warning(const std::filesystem::path& calibration,
                                                       const std::optional<FocusReading>& focus);
// Whether `source` is a camera's name (v4l2:..., libcamera:..., recording:...), no path.
[[nodiscard]] bool names_camera(const std::string& source);

}  // namespace penumbra
