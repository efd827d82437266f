// From a video's stored bytes to the colours that it shows.
#pragma once

#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>

#include "core/image/frame.hpp"

namespace penumbra {

// RGB in [0, 1] = matrix * (yuv - offset), yuv being stored bytes / 255.
struct YuvConversion {
  glm::mat3 rgb_from_yuv{1.0F};
  glm::vec3 offset{0.0F};
};
[[nodiscard]] YuvConversion yuv_conversion(ColorMatrix matrix, ColorRange range);

}  // namespace penumbra
