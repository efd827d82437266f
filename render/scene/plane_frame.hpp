// The coordinates of a shadow plane [m]: (u, v) on the plane, h above it.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cmath>

namespace penumbra {

// Normal n (unit, towards the light) and point q on the plane; axes e1 = normalise(a - (a.n) n) and
// e2 = n x e1, where a = +x, or +y if |n_x| > 0.9. All in the frame in which the plane is defined.
struct PlaneFrame {
  Eigen::Vector3d n = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d q = Eigen::Vector3d::Zero();
  Eigen::Vector3d e1 = Eigen::Vector3d::UnitX();
  Eigen::Vector3d e2 = Eigen::Vector3d::UnitY();

  // `normal` must be finite and not zero.
  [[nodiscard]] static PlaneFrame make(const Eigen::Vector3d& normal,
                                       const Eigen::Vector3d& point) {
    PlaneFrame plane;
    plane.n = normal.normalized();
    plane.q = point;
    const Eigen::Vector3d a =
        std::abs(plane.n.x()) > 0.9 ? Eigen::Vector3d::UnitY() : Eigen::Vector3d::UnitX();
    plane.e1 = (a - a.dot(plane.n) * plane.n).normalized();
    plane.e2 = plane.n.cross(plane.e1);
    return plane;
  }

  // Returns (u, v, h). Subtracts q first, which keeps accuracy far from the origin.
  [[nodiscard]] Eigen::Vector3d to_plane(const Eigen::Vector3d& p) const {
    const Eigen::Vector3d d = p - q;
    return {e1.dot(d), e2.dot(d), n.dot(d)};
  }
  [[nodiscard]] Eigen::Vector3d lift(double u, double v) const { return q + u * e1 + v * e2; }
  // Returns the corners of a disc's bounding square on the plane.
  [[nodiscard]] std::array<Eigen::Vector3d, 4> square_about(const Eigen::Vector2d& centre,
                                                            double radius) const {
    const Eigen::Vector3d middle = lift(centre.x(), centre.y());
    const Eigen::Vector3d u = radius * e1;
    const Eigen::Vector3d v = radius * e2;
    return {middle - u - v, middle + u - v, middle - u + v, middle + u + v};
  }
  [[nodiscard]] double height(const Eigen::Vector3d& p) const { return n.dot(p - q); }
  friend bool operator==(const PlaneFrame&, const PlaneFrame&) = default;
};

}  // namespace penumbra
