// Compares the pixels of two frames. Not for yuyv and nv12: it reads one byte per sample, or three
// in rgb24.
#pragma once

#include <algorithm>

#include "core/image/frame.hpp"

namespace penumbra::test {

inline bool same_pixels(const Frame& a, const Frame& b) {
  if (a.format != b.format || a.width != b.width || a.height != b.height) return false;
  for (std::size_t i = 0; i < static_cast<std::size_t>(a.plane_count); ++i) {
    const PixelPlane& p = a.planes[i];
    const PixelPlane& q = b.planes[i];
    if (p.width != q.width || p.height != q.height) return false;
    const int bytes = p.width * (a.format == PixelFormat::rgb24 ? 3 : 1);
    for (int y = 0; y < p.height; ++y) {
      if (!std::equal(p.data + y * p.stride, p.data + y * p.stride + bytes,
                      q.data + y * q.stride)) {
        return false;
      }
    }
  }
  return true;
}

}  // namespace penumbra::test
