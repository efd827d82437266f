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
  // The same surface before edges were split, and on the way to the finest, each fit for edges
  // about 1.4 times as long as the next one's: of the same positions. Coarsest first.
  struct Coarser {
    std::vector<std::uint32_t> indices;  // triangles
    float longest_edge = 0.0F;           // object frame [m]
  };
  std::vector<Coarser> coarser;
  // The two earlier vertices that each added one lies midway between, from index mesh_positions on.
  std::vector<std::array<std::uint32_t, 2>> midpoint_of;
};

// No edge longer than `max_edge_m`; stops splitting at `max_triangles`. An edge is split the same
// way in all of its faces, so the surface stays closed.
[[nodiscard]] CasterGeometry split_long_edges(const ShadowMesh& mesh, float max_edge_m,
                                              std::size_t max_triangles = 200'000);

// Appends the images of the vertices that splitting added to those of the mesh's own, one each: a
// face's image is straight-edged, so a midpoint's image is the middle between its edge's ends.
void add_midpoints(const CasterGeometry& geometry, std::vector<PlanePoint>& images);

// Triangles, three points each, cut into such with no edge longer than `longest` [m], or into about
// `max_triangles`. An edge is cut the same way in all its triangles.
[[nodiscard]] std::vector<PlanePoint> split_long_edges(std::vector<PlanePoint> triangles,
                                                       float longest,
                                                       std::size_t max_triangles = 200'000);

// One kernel per position, interpolated along edges as clipping does. Each is moved along the
// kernels' up direction to its vertex's height: heights of kernels are irrelevant for that
// direction, and so they are nearly so for those within 2 degrees that the set serves too.
[[nodiscard]] std::vector<glm::vec3> level_kernels(const CasterGeometry& geometry,
                                                   const ShadowKernels& kernels);

}  // namespace penumbra
