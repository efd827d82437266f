// Conservative bounds of objects over planes.
#pragma once

#include <Eigen/Core>
#include <array>
#include <glm/vec3.hpp>

#include "render/model/model.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

using BoxCorners = std::array<Eigen::Vector3d, 8>;
// Returns the corners, in the table frame, of the box from `low` to `high` in the object frame.
[[nodiscard]] BoxCorners box_corners(const glm::vec3& low, const glm::vec3& high,
                                     const Placement& T_table_object);
[[nodiscard]] inline BoxCorners box_corners(const Model& model, const Placement& T_table_object) {
  return box_corners(model.min_corner, model.max_corner, T_table_object);
}

// Returns the lowest and the highest corner's height above the plane [m].
[[nodiscard]] HeightRange heights_above(const PlaneFrame& plane, const BoxCorners& corners);

struct Disc {  // in a plane's (u, v) [m]
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radius = 0.0;
};
// Returns a disc that contains the box's projection along the plane's normal.
[[nodiscard]] Disc footprint(const BoxCorners& corners, const PlaneFrame& plane);

// Returns true if all surfaces have alpha mode BLEND. Such models receive no shadows.
[[nodiscard]] bool all_blends(const Model& model);

}  // namespace penumbra
