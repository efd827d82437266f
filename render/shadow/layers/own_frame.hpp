// A caster's frame on its plane, which slides and turns with the caster: what was made from layers
// in this frame stays valid while the caster does no more than that (docs/shadows.md#own-frame).
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// A rigid motion of the plane: p_plane = turn p_own + slide.
struct PlanarMotion {
  double cosine = 1.0, sine = 0.0;
  Eigen::Vector2d slide = Eigen::Vector2d::Zero();  // [m]

  [[nodiscard]] Eigen::Vector2d operator*(const Eigen::Vector2d& p) const {
    return {cosine * p.x() - sine * p.y() + slide.x(), sine * p.x() + cosine * p.y() + slide.y()};
  }
  friend bool operator==(const PlanarMotion& a, const PlanarMotion& b) {
    return a.cosine == b.cosine && a.sine == b.sine && a.slide == b.slide;
  }
};

// The own frame lies in the plane (z = 0, z up); the object's origin is above its origin, and its
// axes hang on the object alone. Any plane gives the same own frame to the same tilt and height.
struct OwnFrame {
  Placement T_own_object;
  PlanarMotion T_plane_own;

  // Tilt and height are rounded to 2^-`bits` (rad, and shares of `size`, the largest distance of
  // the object's points from its origin [m]): what turns or slides keeps them though they are
  // computed anew, and the same placement always gives the same frame, whatever came before.
  [[nodiscard]] static OwnFrame make(const Placement& T_world_object, const PlaneFrame& plane,
                                     double size, int bits);

  [[nodiscard]] bool same_shape(const OwnFrame& other) const {
    const Placement& a = T_own_object;
    const Placement& b = other.T_own_object;
    return a.position == b.position && a.rotation.coeffs() == b.rotation.coeffs() &&
           a.scale == b.scale;
  }
};

}  // namespace penumbra
