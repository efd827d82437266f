// The casting mesh with its long edges split, so that its shadow's edges can follow a curved lens.
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
  std::vector<glm::vec3> positions;    // object frame [m]; the mesh's own come first
  std::vector<std::uint32_t> indices;  // triangles
  std::size_t mesh_positions = 0;
  // Coarser surfaces of the same positions: before edges were split, and each fit for edges about
  // 1.4 times as long as the next one's. Coarsest first.
  struct Coarser {
    std::vector<std::uint32_t> indices;  // triangles
    float longest_edge = 0.0F;           // object frame [m]
  };
  std::vector<Coarser> coarser;
  // For each vertex from index mesh_positions on, the two earlier ones that it lies midway between.
  std::vector<std::array<std::uint32_t, 2>> midpoint_of;
};

// Splits edges until none is longer than `max_edge_m`, or at `max_triangles`. An edge is split the
// same way in all of its faces, so the surface stays closed.
[[nodiscard]] CasterGeometry split_long_edges(const ShadowMesh& mesh, float max_edge_m,
                                              std::size_t max_triangles = 200'000);

// Appends the images of the added vertices to those of the mesh's own: a face's image has straight
// edges, so a midpoint's image is the middle between those of its edge's ends.
void add_midpoints(const CasterGeometry& geometry, std::vector<PlanePoint>& images);

// Splits triangles, three points each, until no edge is longer than `longest` [m], or into about
// 200,000. An edge is split the same way in all its triangles.
[[nodiscard]] std::vector<PlanePoint> split_long_edges(std::vector<PlanePoint> triangles,
                                                       float longest);

// One kernel per position, interpolated along edges as clipping does, and moved along the kernels'
// up direction to its vertex's height: a kernel then serves directions within 2 degrees as well.
[[nodiscard]] std::vector<glm::vec3> level_kernels(const CasterGeometry& geometry,
                                                   const ShadowKernels& kernels);

}  // namespace penumbra
