// A camera by libcamera: what a Raspberry Pi's camera connector and most phones' sensors need.
// libcamera_source.cpp is the only file that knows libcamera, and what differs between its versions
// (0.0.3 on Debian 12, 0.5 and later on Raspberry Pi OS); libcamera_absent.cpp stands for it where
// it is not installed.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "app/capture/camera_controls.hpp"
#include "app/capture/live_source.hpp"

namespace penumbra {

struct LibcameraOptions : RequestedSettings {
  std::string camera = "0";  // its place in the list, its id, or its model's name
  bool dma_buf = true;       // let a GPU read its buffers where they lie
};

// Opens the camera and starts its viewfinder stream; an error says why it can't be used. Once it
// runs, nothing that the camera does is an error: it is counted, and the source goes on trying
// until stop().
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
  std::string problem;  // why it can't be used; empty: it can
};
// Every camera that libcamera knows, in its order. Fails where penumbra was built without it.
[[nodiscard]] Result<std::vector<LibcameraCamera>> list_libcamera_cameras();

}  // namespace penumbra
