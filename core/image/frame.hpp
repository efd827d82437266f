// A captured video frame: immutable, shared pixels. Destroying its last copy returns the buffer to
// the camera or frees it.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/image/image_view.hpp"

namespace penumbra {

// Memory layouts. Chroma planes have half the width (yuv420p, yuv422p, nv12) and half the height
// (yuv420p, nv12).
enum class PixelFormat {
  grey8,    // plane 0: Y
  rgb24,    // plane 0: R G B bytes
  yuyv,     // plane 0: Y0 U Y1 V bytes, two pixels
  nv12,     // plane 0: Y; plane 1: U V interleaved
  yuv420p,  // planes Y, U, V (V4L2: YU12)
  yuv422p,  // planes Y, U, V
  yuv444p,  // planes Y, U, V
};

enum class ColorMatrix { bt601, bt709 };
enum class ColorRange { full, limited };  // limited: Y in 16..235

// `width` and `height` count samples: 2-byte groups in nv12's plane 1, 4-byte groups in yuyv,
// pixels in rgb24.
struct PixelPlane {
  const std::uint8_t* data = nullptr;
  int width = 0;
  int height = 0;
  std::ptrdiff_t stride = 0;  // [bytes]
};

// The planes' memory as a Linux DMA-BUF, which a GPU can read without a copy.
struct DmaBuf {
  int descriptor = -1;                  // -1: none; Frame::owner keeps it open
  std::uint64_t buffer = 0;             // unique number; descriptors are reused
  std::array<std::size_t, 3> offset{};  // start of each plane in the DMA-BUF [bytes]
};

struct Frame {
  std::uint64_t sequence = 0;  // counts captured frames from 0; a gap is a lost frame
  // Monotonic clock of the source, at the middle of the exposure where known.
  std::int64_t timestamp_ns = 0;
  std::optional<double> exposure_s;  // > 0
  int width = 0;                     // [px]
  int height = 0;                    // [px]
  PixelFormat format = PixelFormat::grey8;
  ColorMatrix color_matrix = ColorMatrix::bt601;
  ColorRange color_range = ColorRange::full;
  std::array<PixelPlane, 3> planes{};
  int plane_count = 0;
  std::shared_ptr<const void> owner;  // keeps the pixels alive
  DmaBuf dma_buf;
  // `timestamp_ns` on the wall clock: UTC since 1970. May go back, because that clock can be set.
  std::optional<std::int64_t> utc_ns;

  [[nodiscard]] bool empty() const { return plane_count == 0; }
};

// Returns the luma, in the frame's own range. Unpacks yuyv and rgb24 into `scratch`, which the
// caller must keep as long as the view; other formats need no copy.
[[nodiscard]] ImageView luma(const Frame& frame, std::vector<std::uint8_t>& scratch);

// A frame on the heap. Its pixels are undefined until a decoder fills them through `plane_data`.
struct FrameBuffer {
  Frame frame;
  std::array<std::uint8_t*, 3> plane_data{};
};
[[nodiscard]] FrameBuffer allocate_frame(PixelFormat format, int width, int height);

}  // namespace penumbra
