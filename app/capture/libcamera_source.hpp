// Camera opened by libcamera; a Raspberry Pi's camera connector requires it. Only
// libcamera_source.cpp includes libcamera (0.0.3 on Debian 12, 0.5 and later on Raspberry Pi OS).
// If libcamera is not installed, libcamera_absent.cpp is built instead.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "app/capture/camera_controls.hpp"
#include "app/capture/live_source.hpp"

namespace penumbra {

struct LibcameraOptions : RequestedSettings {
  std::string camera = "0";  // index in the list, id, or model
  bool dma_buf = true;       // allows a GPU to read the buffers in place
};

// Opens the camera and starts its viewfinder stream. Until stop(), the source counts the camera's
// faults and restarts the stream after them.
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_libcamera_source(
    const LibcameraOptions& options);

struct LibcameraFormat {
  std::string name;                // "NV12"
  bool usable = false;             // penumbra can read it
  std::vector<std::string> sizes;  // "640x480"
};
struct LibcameraCamera {
  std::string id;
  std::string model;
  std::vector<LibcameraFormat> formats;
  std::string problem;  // why penumbra can't use it; empty: it can
};
// Lists all cameras in libcamera's order. Fails if penumbra was built without libcamera.
[[nodiscard]] Result<std::vector<LibcameraCamera>> list_libcamera_cameras();

}  // namespace penumbra
