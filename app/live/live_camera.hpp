// Opens the camera that a command requests, and finds its tag map.
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
  // Without a calibration: the horizontal field of view [degrees].
  std::optional<double> fov_deg;
  std::string camera_name;           // selects one camera of a calibration with several
  std::optional<int> width, height;  // [px]; default: as calibrated
  // Scales the calibration to the size of the images if that is exact. The user asserts that both
  // sizes have the same field of view.
  bool scale_calibration = false;
  std::optional<double> fps;
  std::optional<std::string> format;  // see RequestedSettings::format
  CameraControls controls;
  bool dma_buf = true;    // shares the camera's buffers with the GPU if possible
  bool recorded = false;  // the run records images as captured
};

// The parsed CameraRequest::source.
struct CameraAddress {
  enum class Kind { v4l2, libcamera, recording } kind = Kind::v4l2;
  std::string name;  // name of the device, or folder of the recording
};
[[nodiscard]] Result<CameraAddress> parse_camera(const std::string& source);
// Returns true for v4l2:..., libcamera:... and recording:...; other sources are paths.
[[nodiscard]] bool names_camera(const std::string& source);
// Returns the folder of a recording that is played as a camera; nullopt for other sources.
[[nodiscard]] std::optional<std::filesystem::path> played_recording(const std::string& source);

// Fails if a V4L2 device can't be opened. This quick check runs before slower preparations.
[[nodiscard]] Result<void> check_camera(const CameraAddress& address);
[[nodiscard]] Result<Recording> open_as_camera(const CameraAddress& address);
// Opens the camera at the requested size; default: the size of the calibration `camera`, or of
// RequestedSettings if that is nullptr. Does not check the granted size.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_camera(const CameraAddress& address,
                                                              const CameraRequest& request,
                                                              const CameraModel* camera);
// Fails if the stream's size differs from the calibration's. Suggests --scale-calibration if that
// is exact.
[[nodiscard]] Result<void> check_size_or_offer_scaling(const CameraRequest& request,
                                                       const CameraAddress& address,
                                                       const StreamFormat& format,
                                                       const CameraModel& camera);
// Returns the calibration, scaled to the requested or recorded size if scale_calibration is set.
[[nodiscard]] Result<CameraModel> calibration_at_size(const CameraRequest& request,
                                                      const CameraAddress& address,
                                                      const CameraModel& camera);

// Returns a lens without distortion, whose uncertainty is so large that no pose is tracked.
[[nodiscard]] Result<CameraModel> guessed_camera(double fov_deg, int width, int height);

// Checks and opens the requested camera. Fails if its size is not that of the calibration `camera`.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_live_source(
    const CameraRequest& request, const CameraModel* camera = nullptr);
// Returns a warning if the focus differs from the focus of the calibration. Returns nullopt if they
// are equal, or if either is unknown.
[[nodiscard]] std::optional<std::string> focus_warning(const std::filesystem::path& calibration,
                                                       const std::optional<FocusReading>& focus);

// Returns the tag map for a camera: `named` (--tags), else the tag map of the recording that is
// played as a camera, else tags.yaml beside the calibration. Fails if none exists.
[[nodiscard]] Result<std::filesystem::path> tags_for_camera(
    const std::optional<std::filesystem::path>& named, const CameraRequest& camera);

}  // namespace penumbra
