#include "core/image/frame.hpp"

#include "core/assert.hpp"

namespace penumbra {
namespace {

struct PlaneLayout {
  int width = 0;
  int height = 0;
  int bytes_per_sample = 1;
};

struct Layout {
  std::array<PlaneLayout, 3> planes{};
  int count = 0;
};

Layout layout_of(PixelFormat format, int width, int height) {
  const int half_width = (width + 1) / 2;
  const int half_height = (height + 1) / 2;
  switch (format) {
    case PixelFormat::grey8:
      return {{{{width, height, 1}}}, 1};
    case PixelFormat::rgb24:
      return {{{{width, height, 3}}}, 1};
    case PixelFormat::yuyv:
      return {{{{half_width, height, 4}}}, 1};
    case PixelFormat::nv12:
      return {{{{width, height, 1}, {half_width, half_height, 2}}}, 2};
    case PixelFormat::yuv420p:
      return {{{{width, height, 1}, {half_width, half_height, 1}, {half_width, half_height, 1}}},
              3};
    case PixelFormat::yuv422p:
      return {{{{width, height, 1}, {half_width, height, 1}, {half_width, height, 1}}}, 3};
    case PixelFormat::yuv444p:
      return {{{{width, height, 1}, {width, height, 1}, {width, height, 1}}}, 3};
  }
  return {};
}

}  // namespace

ImageView luma(const Frame& frame, std::vector<std::uint8_t>& scratch) {
  PENUMBRA_ASSERT(!frame.empty());
  const PixelPlane& plane = frame.planes[0];
  if (frame.format != PixelFormat::yuyv && frame.format != PixelFormat::rgb24) {
    return {plane.data, frame.width, frame.height, plane.stride};
  }
  const auto width = static_cast<std::size_t>(frame.width);
  scratch.resize(width * static_cast<std::size_t>(frame.height));
  for (int y = 0; y < frame.height; ++y) {
    const std::uint8_t* in = plane.data + y * plane.stride;
    std::uint8_t* out = scratch.data() + static_cast<std::size_t>(y) * width;
    if (frame.format == PixelFormat::yuyv) {
      for (std::size_t x = 0; x < width; ++x) out[x] = in[2 * x];
    } else {
      // BT.601 luma in 16-bit fixed point: weights 0.299, 0.587, 0.114, with the sum 65536.
      for (std::size_t x = 0; x < width; ++x) {
        const std::uint8_t* rgb = in + 3 * x;
        out[x] = static_cast<std::uint8_t>(
            (19595U * rgb[0] + 38470U * rgb[1] + 7471U * rgb[2] + 32768U) >> 16U);
      }
    }
  }
  return {scratch.data(), frame.width, frame.height, frame.width};
}

FrameBuffer allocate_frame(PixelFormat format, int width, int height) {
  PENUMBRA_ASSERT(width > 0 && height > 0);
  const Layout layout = layout_of(format, width, height);
  std::size_t total = 0;
  std::array<std::size_t, 3> offset{};
  std::array<std::size_t, 3> stride{};
  for (std::size_t i = 0; i < static_cast<std::size_t>(layout.count); ++i) {
    const PlaneLayout& plane = layout.planes[i];
    // Rows start on 16-byte boundaries, for decoders and texture uploads.
    stride[i] =
        (static_cast<std::size_t>(plane.width * plane.bytes_per_sample) + 15U) & ~std::size_t{15};
    offset[i] = total;
    total += stride[i] * static_cast<std::size_t>(plane.height);
  }
  std::shared_ptr<std::uint8_t[]> memory(new std::uint8_t[total]);

  FrameBuffer buffer;
  buffer.frame.width = width;
  buffer.frame.height = height;
  buffer.frame.format = format;
  buffer.frame.plane_count = layout.count;
  for (std::size_t i = 0; i < static_cast<std::size_t>(layout.count); ++i) {
    buffer.plane_data[i] = memory.get() + offset[i];
    buffer.frame.planes[i] = {buffer.plane_data[i], layout.planes[i].width, layout.planes[i].height,
                              static_cast<std::ptrdiff_t>(stride[i])};
  }
  buffer.frame.owner = std::move(memory);
  return buffer;
}

}  // namespace penumbra
