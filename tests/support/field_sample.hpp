// Samples a shadow field at points of the plane.
#pragma once

#include <cmath>

#include "render/shadow/fields/power_distance.hpp"

namespace penumbra::test {

// Interpolates bilinearly; returns -1 outside the raster.
inline float field_at(const ShadowField& field, ShadowLayer layer, const Eigen::Vector2d& p) {
  const std::vector<float>& values = field.layer(layer);
  const Eigen::Vector2d at = (p - field.origin) / field.cell - Eigen::Vector2d::Constant(0.5);
  const double column = std::floor(at.x());
  const double row = std::floor(at.y());
  if (!(column >= 0.0 && row >= 0.0 && column < field.width - 1 && row < field.height - 1))
    return -1.0F;
  const auto stride = static_cast<std::size_t>(field.width);
  const std::size_t i = static_cast<std::size_t>(row) * stride + static_cast<std::size_t>(column);
  const auto fx = static_cast<float>(at.x() - column);
  const auto fy = static_cast<float>(at.y() - row);
  const float low = values[i] + fx * (values[i + 1] - values[i]);
  const float high = values[i + stride] + fx * (values[i + stride + 1] - values[i + stride]);
  return low + fy * (high - low);
}

}  // namespace penumbra::test
