// A caster's frame on its plane, which slides and turns with the caster: geometry in this frame
// stays valid while the caster only slides and turns (docs/shadows.md#own-frame).
#pragma once

#include <Eigen/Core>

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
  friend bool operator==(const PlanarMotion&, const PlanarMotion&) = default;
};

// The own frame lies in the plane (z = 0, z up), its origin under the object's. Its axes depend
// only on the object: the same tilt and height give the same own frame on any plane.
struct OwnFrame {
  Placement T_own_object;
  PlanarMotion T_plane_own;

  // Tilt and height are rounded to 2^-bits (rad; shares of `size`, the largest distance of the
  // object's points from its origin [m]), so that turning and sliding keep them exactly.
  [[nodiscard]] static OwnFrame make(const Placement& T_world_object, const PlaneFrame& plane,
                                     double size, int bits);

  [[nodiscard]] bool same_shape(const OwnFrame& other) const {
    return T_own_object == other.T_own_object;
  }
  friend bool operator==(const OwnFrame&, const OwnFrame&) = default;
};

}  // namespace penumbra
