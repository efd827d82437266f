// A camera by Video4Linux: buffers of the driver, mapped and lent to frames without a copy.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "app/capture/camera_controls.hpp"
#include "app/capture/live_source.hpp"

namespace penumbra {

struct V4l2Options {
  std::filesystem::path device = "/dev/video0";
  int width = 640;    // [px] wished for; what the driver grants is obeyed
  int height = 480;   // [px]
  double fps = 30.0;  // wished for
  // grey, nv12, yu12, yuyv or mjpeg; nothing: the one that costs least at that size and rate.
  std::optional<std::string> format;
  // JPEGs are written to disk as they come, others have to be coded: they cost more then.
  bool recording = false;
  CameraControls controls;
};

// Opens the camera and starts it; an error says why it can't be used. Once it runs, nothing that
// the camera does is an error: it is counted, and the source goes on trying until stop().
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_v4l2_source(const V4l2Options& options);

}  // namespace penumbra
