// Rays from a light through vertices of a caster to the shadows of these vertices (Sudarsky,
// "Generating Dynamic Shadows for Virtual Reality Applications", figure 4).
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
// Chooses at most `most` vertices: the one farthest from the middle of the model's box, then each
// time the one farthest from those chosen (a box gives its corners). Colours are the model's where
// it has one per vertex, and otherwise differ from each other.
[[nodiscard]] std::vector<MarkedVertex> marked_vertices(const Model& model, std::size_t most);

// A parallel light's rays begin this far before the vertex [m].
inline constexpr double kParallelRay = 0.25;

struct RayReceiver {
  PlaneFrame frame;
  std::span<const Eigen::Vector2d> outline;  // empty: infinite
};
struct LightRay {
  Eigen::Vector3d from;    // the light, or for a parallel one a point towards it
  Eigen::Vector3d vertex;  // table frame [m], as all three
  Eigen::Vector3d shadow;
  glm::vec3 color;
};
// One ray for each vertex whose shadow falls onto one of the planes, to the nearest of them.
// `light` as in projected_shadow.hpp, table frame.
[[nodiscard]] std::vector<LightRay> light_rays(std::span<const MarkedVertex> vertices,
                                               const Placement& T_table_object,
                                               const Eigen::Vector4d& light,
                                               std::span<const RayReceiver> planes);

}  // namespace penumbra
