// The casting mesh with long edges split, so that its shadow's edges follow the lens distortion.
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

#include "render/model/shadow_mesh.hpp"
#include "render/shadow/kernels/shadow_kernels.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

struct CasterGeometry {
  std::vector<glm::vec3> positions;    // object frame [m]; first those of the input mesh
  std::vector<std::uint32_t> indices;  // triangles
  std::size_t mesh_positions = 0;      // number of positions of the input mesh
  // Coarser meshes over the same positions, coarsest first: the unsplit mesh, then meshes that each
  // have a longest edge about 1.4 times shorter than the previous mesh.
  struct Coarser {
    std::vector<std::uint32_t> indices;  // triangles
    float longest_edge = 0.0F;           // object frame [m]
  };
  std::vector<Coarser> coarser;
  // For each added vertex (index >= mesh_positions): the two earlier vertices whose midpoint it is.
  std::vector<std::array<std::uint32_t, 2>> midpoint_of;
};

// Splits edges until none is longer than `max_edge_m` or the mesh has `max_triangles`. All faces at
// an edge share its midpoint, so a closed surface stays closed.
[[nodiscard]] CasterGeometry split_long_edges(const ShadowMesh& mesh, float max_edge_m,
                                              std::size_t max_triangles = 200'000);

// `points` holds the projected vertices of the input mesh; appends those of the added vertices. A
// projected edge is straight, so its midpoint is the mean of its projected ends.
void add_midpoints(const CasterGeometry& geometry, std::vector<PlanePoint>& points);

// Splits triangles, three points each, until no edge is longer than `longest` [m] or there are
// about 200,000. All triangles at an edge share its midpoint.
[[nodiscard]] std::vector<PlanePoint> split_long_edges(std::vector<PlanePoint> triangles,
                                                       float longest);

// Returns one kernel per position, interpolated along edges as in clip_to_heights(). Each kernel is
// moved along the up direction to its vertex's height, so that the kernels are also usable for
// up directions within 2 degrees.
[[nodiscard]] std::vector<glm::vec3> level_kernels(const CasterGeometry& geometry,
                                                   const ShadowKernels& kernels);

}  // namespace penumbra
