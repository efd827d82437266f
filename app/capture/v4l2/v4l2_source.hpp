// A camera by Video4Linux: buffers of the driver, mapped and lent to frames without a copy.
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
  bool dma_buf = true;  // share its buffers, where the driver can
};

// Opens the camera and starts it; an error says why it can't be used. Once it runs, nothing that
// the camera does is an error: it is counted, and the source goes on trying until stop().
[[nodiscard]] Result<std::unique_ptr<LiveSource>> open_v4l2_source(const V4l2Options& options);

// What a driver's description of its colours (v4l2_pix_format) means for luma and chroma: where it
// leaves the encoding or the range open, as its colour space has them. Of encodings that are
// neither BT.601's nor BT.709's (BT.2020, SMPTE 240M) BT.709 is the nearer one.
struct VideoColors {
  ColorMatrix matrix = ColorMatrix::bt601;
  ColorRange range = ColorRange::limited;
  friend bool operator==(const VideoColors&, const VideoColors&) = default;
};
[[nodiscard]] VideoColors v4l2_colors(std::uint32_t colorspace, std::uint32_t ycbcr_enc,
                                      std::uint32_t quantization);

// Whether pictures of this format can be read.
[[nodiscard]] bool reads_v4l2_format(std::uint32_t fourcc);

}  // namespace penumbra
