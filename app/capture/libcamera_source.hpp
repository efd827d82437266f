// A camera by libcamera, as a Raspberry Pi's camera connector needs it. Only libcamera_source.cpp
// includes libcamera (0.0.3 on Debian 12, 0.5 and later on Raspberry Pi OS); libcamera_absent.cpp
// replaces it if it is not installed.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "app/capture/camera_controls.hpp"
#include "app/capture/live_source.hpp"

namespace penumbra {

struct LibcameraOptions : RequestedSettings {
  std::string camera = "0";  // index in the list, id, or model
  bool dma_buf = true;       // lets a GPU read the buffers in place
};

// Opens the camera and starts its viewfinder stream. Once it runs, faults of the camera are
// counted, and the source retries until stop().
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_libcamera_source(
    const LibcameraOptions& options);

struct LibcameraFormat {
  std::string name;                // "NV12"
  bool usable = false;             // by penumbra
  std::vector<std::string> sizes;  // "640x480"
};
struct LibcameraCamera {
  std::string id;
  std::string model;
  std::vector<LibcameraFormat> formats;
  std::string problem;  // why it can't be used; empty: it can be
};
// All cameras of libcamera, in its order. Fails if penumbra was built without it.
[[nodiscard]] Result<std::vector<LibcameraCamera>> list_libcamera_cameras();

}  // namespace penumbra
