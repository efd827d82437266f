// Computes rays from a light through vertices of a caster to their shadows (Sudarsky, "Generating
// Dynamic Shadows for Virtual Reality Applications", figure 4).
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "render/model/model.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

struct MarkedVertex {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // object frame [m]
  glm::vec3 color{1.0F};                               // linear light
};
// Chooses up to `limit` vertices by farthest-point sampling, starting with the vertex farthest from
// the centre of the model's box; for a box these are its corners. The colours are the model's
// vertex colours or, if it has none, distinct hues.
[[nodiscard]] std::vector<MarkedVertex> marked_vertices(const Model& model, std::size_t limit);

// Rays of a parallel light start at this distance before the vertex [m].
inline constexpr double kRayLength_m = 0.25;

struct RayReceiver {
  PlaneFrame frame;
  std::span<const Eigen::Vector2d> outline;  // empty: infinite
};
struct LightRay {        // points: table frame [m]
  Eigen::Vector3d from;  // position of the light; parallel light: a point towards it
  Eigen::Vector3d vertex;
  Eigen::Vector3d shadow;
  glm::vec3 color;
};
// Returns one ray for each vertex whose shadow falls onto a plane, ending on the nearest such
// plane. `light` as in projected_shadow.hpp, table frame.
[[nodiscard]] std::vector<LightRay> light_rays(std::span<const MarkedVertex> vertices,
                                               const Placement& T_table_object,
                                               const Eigen::Vector4d& light,
                                               std::span<const RayReceiver> planes);

}  // namespace penumbra
