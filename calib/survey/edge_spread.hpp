// What moves the edges of a black square in a picture moves its corners too.
#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <cstddef>

namespace penumbra {

// How each corner of a square [px], in either order around it, moves when all its edges move
// outwards by 1 px: tone curves and blur do that. Zero where two edges are nearly one line.
[[nodiscard]] inline std::array<Eigen::Vector2d, 4> edge_spreads(
    const std::array<Eigen::Vector2d, 4>& corners) {
  const Eigen::Vector2d centre = 0.25 * (corners[0] + corners[1] + corners[2] + corners[3]);
  const auto outward = [&](const Eigen::Vector2d& p, const Eigen::Vector2d& q) {
    Eigen::Vector2d n(-(q - p).y(), (q - p).x());
    n.normalize();
    return n.dot(p - centre) < 0.0 ? Eigen::Vector2d(-n) : n;
  };
  std::array<Eigen::Vector2d, 4> spreads;
  for (std::size_t i = 0; i < 4; ++i) {
    Eigen::Matrix2d normals;
    normals.row(0) = outward(corners[(i + 3) % 4], corners[i]).transpose();
    normals.row(1) = outward(corners[i], corners[(i + 1) % 4]).transpose();
    spreads[i] = std::abs(normals.determinant()) < 0.2
                     ? Eigen::Vector2d(Eigen::Vector2d::Zero())
                     : Eigen::Vector2d(normals.inverse() * Eigen::Vector2d::Ones());
  }
  return spreads;
}

}  // namespace penumbra
