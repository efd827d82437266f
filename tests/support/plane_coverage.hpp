// Points of a plane that a set of triangles covers, for tests of single pixels.
#pragma once

#include <Eigen/Core>
#include <span>

#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra::test {

// Returns true if `p` (u, v) lies inside one of the triangles (three points each), not on an edge.
inline bool covers(std::span<const PlanePoint> triangles, const Eigen::Vector2d& p) {
  const auto side = [&p](const PlanePoint& a, const PlanePoint& b) {
    return (static_cast<double>(b.u) - static_cast<double>(a.u)) *
               (p.y() - static_cast<double>(a.v)) -
           (static_cast<double>(b.v) - static_cast<double>(a.v)) *
               (p.x() - static_cast<double>(a.u));
  };
  for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
    const double a = side(triangles[i], triangles[i + 1]);
    const double b = side(triangles[i + 1], triangles[i + 2]);
    const double c = side(triangles[i + 2], triangles[i]);
    if ((a > 0 && b > 0 && c > 0) || (a < 0 && b < 0 && c < 0)) return true;
  }
  return false;
}

}  // namespace penumbra::test
