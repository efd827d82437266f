// Opens the camera that a command names, and finds its tag map.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "app/capture/camera_controls.hpp"
#include "app/capture/live_source.hpp"
#include "app/recording/recording_source.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"

namespace penumbra {

struct CameraRequest {
  std::string source = "v4l2:/dev/video0";  // or libcamera:NAME, recording:FOLDER
  std::filesystem::path calibration;
  std::string camera_name;           // in a calibration with several cameras
  std::optional<int> width, height;  // [px]; default: as calibrated
  // Scales the calibration to the size of the images where that is exact; the caller asserts that
  // both sizes have the same field of view.
  bool scale_calibration = false;
  std::optional<double> fps;
  std::optional<std::string> format;  // V4L2
  CameraControls controls;
  bool dma_buf = true;    // V4L2 buffers are shared with the GPU if possible
  bool recorded = false;  // images are stored as captured
};

// The parts of a source's name.
struct CameraAddress {
  enum class Kind { v4l2, libcamera, recording } kind = Kind::v4l2;
  std::string name;  // of the device, or the recording's folder
};
[[nodiscard]] Result<CameraAddress> parse_camera(const std::string& source);
// Returns true for v4l2:..., libcamera:... and recording:..., which are no paths.
[[nodiscard]] bool names_camera(const std::string& source);
// The folder of a recording that is played as a camera; nothing for other sources.
[[nodiscard]] std::optional<std::filesystem::path> played_recording(const std::string& source);

// Fails if a V4L2 device can't be opened; quick, before anything else is set up.
[[nodiscard]] Result<void> check_camera(const CameraAddress& address);
[[nodiscard]] Result<Recording> open_as_camera(const CameraAddress& address);
// Opens the camera at the requested size; default: that of `camera`, or without one the camera's
// first. The size is not checked.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_camera(const CameraAddress& address,
                                                              const CameraRequest& request,
                                                              const CameraModel* camera);
// Fails if the stream's size is not the calibration's; offers --scale-calibration if that is exact.
[[nodiscard]] Result<void> check_size_or_offer_scaling(const CameraRequest& request,
                                                       const CameraAddress& address,
                                                       const StreamFormat& format,
                                                       const CameraModel& camera);
// The calibration at the requested size, or at that of a recording, if the request scales it.
[[nodiscard]] Result<CameraModel> calibration_at_size(const CameraRequest& request,
                                                      const CameraAddress& address,
                                                      const CameraModel& camera);

// Checks and opens the camera of the request. Fails if its size is not that of `camera`.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_live_source(
    const CameraRequest& request, const CameraModel* camera = nullptr);
// A warning if the lens is focused elsewhere than when it was calibrated; nothing if either
// position is unknown.
[[nodiscard]] std::optional<std::string> focus_warning(const std::filesystem::path& calibration,
                                                       const std::optional<FocusReading>& focus);

// The tag map for a camera: the one that is named (--tags), that of the recording that is played as
// a camera, or tags.yaml beside the calibration. Fails if there is none.
[[nodiscard]] Result<std::filesystem::path> tags_for_camera(
    const std::optional<std::filesystem::path>& named, const std::string& camera,
    const std::filesystem::path& calibration);

}  // namespace penumbra
