// Offsets of an image's planes in one camera buffer. V4L2 and libcamera store them one after the
// other, and derive their strides from the first plane's.
#pragma once

#include <array>
#include <cstddef>

#include "core/image/frame.hpp"

namespace penumbra {

struct FrameLayout {
  std::array<std::size_t, 3> offset{};  // offset of each plane [bytes]
  Frame frame;                          // complete except for the planes' data pointers
  std::size_t bytes = 0;                // size of a whole image
};

// Computes the layout. `width`, `height` [px] must be at least 1. `stride`: row stride of the first
// plane [bytes]; a value below the row length is raised to it.
[[nodiscard]] FrameLayout frame_layout(PixelFormat format, int width, int height,
                                       std::ptrdiff_t stride);

}  // namespace penumbra
