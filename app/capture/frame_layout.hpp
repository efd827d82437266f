// Offsets of an image's planes in one buffer of a camera, as V4L2 and libcamera lay them out: one
// behind the other, with the stride of the first.
#pragma once

#include <array>
#include <cstddef>

#include "core/image/frame.hpp"

namespace penumbra {

struct FrameLayout {
  std::array<std::size_t, 3> offset{};  // of each plane [bytes]
  Frame frame;                          // all but the planes' data
  std::size_t bytes = 0;                // of a whole image
};

// `width`, `height` [px] at least 1; `stride` [bytes] of the first plane's rows, raised to their
// length.
[[nodiscard]] FrameLayout frame_layout(PixelFormat format, int width, int height,
                                       std::ptrdiff_t stride);

}  // namespace penumbra
