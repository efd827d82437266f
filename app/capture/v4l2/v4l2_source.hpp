// Video4Linux camera. Frames view the driver's mapped buffers, or copies if few buffers are left.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "app/capture/camera_controls.hpp"
#include "app/capture/live_source.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

struct V4l2Options : RequestedSettings {
  std::filesystem::path device = "/dev/video0";
  bool dma_buf = true;  // shares buffers with the GPU if the driver can export them
};

// Opens the camera and starts its stream. After that, the source counts the camera's faults and
// restarts the stream until stop().
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_v4l2_source(const V4l2Options& options);

// YCbCr encoding and range of a driver's format (v4l2_pix_format). If the driver reports a default,
// the colour space determines it. Encodings other than BT.601 and BT.709 (BT.2020, SMPTE 240M) are
// treated as BT.709, which is more similar to them than BT.601.
struct VideoColors {
  ColorMatrix matrix = ColorMatrix::bt601;
  ColorRange range = ColorRange::limited;
  friend bool operator==(const VideoColors&, const VideoColors&) = default;
};
[[nodiscard]] VideoColors v4l2_colors(std::uint32_t colorspace, std::uint32_t ycbcr_enc,
                                      std::uint32_t quantization);

[[nodiscard]] bool reads_v4l2_format(std::uint32_t fourcc);

}  // namespace penumbra
