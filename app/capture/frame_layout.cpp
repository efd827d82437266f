#include "app/capture/frame_layout.hpp"

#include <algorithm>

namespace penumbra {

FrameLayout frame_layout(PixelFormat format, int width, int height, std::ptrdiff_t stride) {
  FrameLayout layout;
  Frame& frame = layout.frame;
  frame.width = width;
  frame.height = height;
  frame.format = format;
  const int half_width = (width + 1) / 2;
  const int half_height = (height + 1) / 2;
  const int first_width = format == PixelFormat::yuyv ? half_width : width;
  const std::ptrdiff_t pixel_bytes = format == PixelFormat::yuyv    ? 2
                                     : format == PixelFormat::rgb24 ? 3
                                                                    : 1;
  stride = std::max(stride, pixel_bytes * width);
  frame.planes[0] = {nullptr, first_width, height, stride};
  frame.plane_count = 1;
  if (format == PixelFormat::nv12) {
    frame.planes[1] = {nullptr, half_width, half_height, stride};
    frame.plane_count = 2;
  } else if (format == PixelFormat::yuv420p) {
    frame.planes[1] = frame.planes[2] = {nullptr, half_width, half_height, stride / 2};
    frame.plane_count = 3;
  }
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
    layout.offset[i] = layout.bytes;
    layout.bytes += static_cast<std::size_t>(frame.planes[i].stride) *
                    static_cast<std::size_t>(frame.planes[i].height);
  }
  return layout;
}

}  // namespace penumbra
