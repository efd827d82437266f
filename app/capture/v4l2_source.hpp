// A camera by Video4Linux: buffers of the driver, mapped and lent to frames without a copy.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "app/capture/camera_controls.hpp"
#include "app/capture/live_source.hpp"

namespace penumbra {

struct V4l2Options : CameraWish {
  std::filesystem::path device = "/dev/video0";
  bool dma_buf = true;  // share its buffers, where the driver can
};

// Opens the camera and starts it; an error says why it can't be used. Once it runs, nothing that
// the camera does is an error: it is counted, and the source goes on trying until stop().
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_v4l2_source(const V4l2Options& options);

// Whether pictures of this format can be read.
[[nodiscard]] bool reads_v4l2_format(std::uint32_t fourcc);

}  // namespace penumbra
