// Converts a video's stored bytes to RGB.
#pragma once

#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>

#include "core/image/frame.hpp"

namespace penumbra {

// RGB in [0, 1] = rgb_from_yuv * (yuv - offset), where yuv = stored bytes / 255.
struct YuvConversion {
  glm::mat3 rgb_from_yuv{1.0F};
  glm::vec3 offset{0.0F};
};
[[nodiscard]] inline YuvConversion yuv_conversion(ColorMatrix matrix, ColorRange range) {
  // Luma coefficients of red and blue of ITU-R BT.601 and BT.709.
  const float kr = matrix == ColorMatrix::bt601 ? 0.299F : 0.2126F;
  const float kb = matrix == ColorMatrix::bt601 ? 0.114F : 0.0722F;
  const float kg = 1.0F - kr - kb;
  const bool limited = range == ColorRange::limited;
  const float y = limited ? 255.0F / 219.0F : 1.0F;
  const float c = limited ? 255.0F / 224.0F : 1.0F;
  const float v_red = 2.0F * (1.0F - kr) * c;
  const float u_blue = 2.0F * (1.0F - kb) * c;
  YuvConversion conversion;
  conversion.rgb_from_yuv =
      glm::mat3(glm::vec3(y, y, y), glm::vec3(0.0F, -u_blue * kb / kg, u_blue),
                glm::vec3(v_red, -v_red * kr / kg, 0.0F));
  conversion.offset = {limited ? 16.0F / 255.0F : 0.0F, 128.0F / 255.0F, 128.0F / 255.0F};
  return conversion;
}

}  // namespace penumbra
