// Grey levels between pixels.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <optional>

#include "core/image/image_view.hpp"

namespace penumbra {

// By bilinear interpolation [grey levels]; nothing outside the image. (0, 0) is the centre of the
// top-left pixel.
[[nodiscard]] inline std::optional<double> sample_luma(ImageView luma, const Eigen::Vector2d& p) {
  if (!(p.x() >= 0.0 && p.y() >= 0.0 && p.x() <= luma.width - 1 && p.y() <= luma.height - 1))
    return std::nullopt;
  const int x = std::min(static_cast<int>(p.x()), luma.width - 2);
  const int y = std::min(static_cast<int>(p.y()), luma.height - 2);
  if (x < 0 || y < 0) return std::nullopt;
  const double u = p.x() - x;
  const double v = p.y() - y;
  const std::uint8_t* a = luma.row(y) + x;
  const std::uint8_t* b = luma.row(y + 1) + x;
  return (1.0 - v) * ((1.0 - u) * a[0] + u * a[1]) + v * ((1.0 - u) * b[0] + u * b[1]);
}

}  // namespace penumbra
