// One captured video frame: views of the pixels as they came, immutable and shared.
// Copying a Frame copies the views; the last copy's destructor gives the buffer back (to the
// camera's ring, or the heap).
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/image/image_view.hpp"

namespace penumbra {

// Memory layouts. Chroma planes are half width (yuv420p, yuv422p, nv12), half height (yuv420p,
// nv12).
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

// One plane: `width` and `height` count samples of that plane (of nv12's plane 1 and yuyv's plane
// 0: 2- and 4-byte groups, of rgb24: pixels).
struct PixelPlane {
  const std::uint8_t* data = nullptr;
  int width = 0;
  int height = 0;
  std::ptrdiff_t stride = 0;  // [bytes]
};

// The memory that a frame's planes lie in, as Linux shares it among devices (DMA-BUF): a GPU can
// read the picture where the camera put it.
struct DmaBuf {
  int descriptor = -1;                  // -1: none; open as long as the frame's owner lives
  std::uint64_t buffer = 0;             // which one it is: descriptors are used again, this is not
  std::array<std::size_t, 3> offset{};  // of each plane [bytes]
};

struct Frame {
  std::uint64_t sequence = 0;  // counts captured frames from 0; a gap is a lost frame
  std::int64_t timestamp_ns =
      0;  // monotonic clock of the source, at the middle of the exposure where known
  std::optional<double> exposure_s;  // how long light was gathered, where known; > 0
  int width = 0;                     // [px]
  int height = 0;                    // [px]
  PixelFormat format = PixelFormat::grey8;
  ColorMatrix color_matrix = ColorMatrix::bt601;
  ColorRange color_range = ColorRange::full;
  std::array<PixelPlane, 3> planes{};
  int plane_count = 0;
  std::shared_ptr<const void> owner;  // keeps the pixels alive
  DmaBuf dma_buf;                     // where the planes lie, if a device has shared it

  [[nodiscard]] bool empty() const { return plane_count == 0; }
};

// The luma of a frame, in [0, 255] of the frame's own range. Formats with a luma plane are viewed
// where they lie; yuyv and rgb24 are unpacked into `scratch` (one pass), which must outlive the
// view.
[[nodiscard]] ImageView luma(const Frame& frame, std::vector<std::uint8_t>& scratch);

// A heap frame with uninitialised planes, for decoders: fill `planes[i].data` through `plane_data`.
struct FrameBuffer {
  Frame frame;
  std::array<std::uint8_t*, 3> plane_data{};
};
[[nodiscard]] FrameBuffer allocate_frame(PixelFormat format, int width, int height);

}  // namespace penumbra
