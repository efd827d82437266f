// A caster's own frame on its plane, which moves with the caster: geometry in this frame stays
// valid while the caster only translates and rotates in the plane (docs/shadows.md#own-frame).
#pragma once

#include <Eigen/Core>

#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// A rigid motion in the plane: p_plane = R(cosine, sine) p_own + displacement.
struct PlanarMotion {
  double cosine = 1.0, sine = 0.0;
  Eigen::Vector2d displacement = Eigen::Vector2d::Zero();  // [m]

  [[nodiscard]] Eigen::Vector2d operator*(const Eigen::Vector2d& p) const {
    return {cosine * p.x() - sine * p.y() + displacement.x(),
            sine * p.x() + cosine * p.y() + displacement.y()};
  }
  friend bool operator==(const PlanarMotion&, const PlanarMotion&) = default;
};

// The own frame lies in the plane (z = 0, z up), with its origin below the object's origin. Its
// axes depend only on the object: the same tilt and height give the same T_own_object on any plane.
struct OwnFrame {
  Placement T_own_object;
  PlanarMotion T_plane_own;

  // Rounds the tilt to multiples of 2^-bits rad and the height to multiples of 2^-bits * `size`, so
  // that motion in the plane leaves them exactly unchanged. `size`: largest distance of a point of
  // the object from its origin [m].
  [[nodiscard]] static OwnFrame make(const Placement& T_world_object, const PlaneFrame& plane,
                                     double size, int bits);

  [[nodiscard]] bool same_shape(const OwnFrame& other) const {
    return T_own_object == other.T_own_object;
  }
  friend bool operator==(const OwnFrame&, const OwnFrame&) = default;
};

}  // namespace penumbra
