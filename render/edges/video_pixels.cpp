#include "render/edges/video_pixels.hpp"

#include <glm/common.hpp>

namespace penumbra {

glm::vec3 VideoPixels::at(int x, int y) const {
  glm::vec3 yuv(0.0F, 255.0F * conversion_.offset.y, 255.0F * conversion_.offset.z);
  switch (frame_.format) {
    case PixelFormat::rgb24:
      return {stored(0, 3 * x, y), stored(0, 3 * x + 1, y), stored(0, 3 * x + 2, y)};
    case PixelFormat::grey8:
      yuv.x = stored(0, x, y);
      break;
    case PixelFormat::yuyv:
      yuv = {stored(0, 2 * x, y), stored(0, 4 * (x / 2) + 1, y), stored(0, 4 * (x / 2) + 3, y)};
      break;
    case PixelFormat::nv12:
      yuv = {stored(0, x, y), stored(1, 2 * (x / 2), y / 2), stored(1, 2 * (x / 2) + 1, y / 2)};
      break;
    case PixelFormat::yuv420p:
      yuv = {stored(0, x, y), stored(1, x / 2, y / 2), stored(2, x / 2, y / 2)};
      break;
    case PixelFormat::yuv422p:
      yuv = {stored(0, x, y), stored(1, x / 2, y), stored(2, x / 2, y)};
      break;
    case PixelFormat::yuv444p:
      yuv = {stored(0, x, y), stored(1, x, y), stored(2, x, y)};
      break;
  }
  return glm::clamp(conversion_.rgb_from_yuv * (yuv - 255.0F * conversion_.offset), 0.0F, 255.0F);
}

}  // namespace penumbra
