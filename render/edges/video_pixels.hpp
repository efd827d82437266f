// Reads single pixels of a captured frame as RGB, like video_texel.glsl.
#pragma once

#include <cstddef>
#include <glm/vec3.hpp>

#include "core/image/frame.hpp"
#include "render/scene/yuv_conversion.hpp"

namespace penumbra {

class VideoPixels {
 public:
  // `frame` must outlive the object.
  explicit VideoPixels(const Frame& frame)
      : frame_(frame), conversion_(yuv_conversion(frame.color_matrix, frame.color_range)) {}

  // Returns the pixel's RGB codes, 0 .. 255, not rounded.
  [[nodiscard]] glm::vec3 at(int x, int y) const;

 private:
  [[nodiscard]] float stored(std::size_t plane, int byte, int row) const {
    const PixelPlane& from = frame_.planes[plane];
    return static_cast<float>(from.data[row * from.stride + byte]);
  }

  const Frame& frame_;
  YuvConversion conversion_;
};

}  // namespace penumbra
