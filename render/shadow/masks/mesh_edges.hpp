// Edges and orientation of meshes, for masks.
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <vector>

namespace penumbra {

// An edge from one vertex to another in one face, and back in another.
struct SharedEdge {
  std::uint32_t from = 0, to = 0;       // vertices
  std::uint32_t forward = 0, back = 0;  // faces
};
// Returns all edges of a closed mesh, in which every edge runs as often one way as the other;
// nothing for other meshes. More than two faces at an edge are paired in any order.
[[nodiscard]] std::optional<std::vector<SharedEdge>> paired_edges(
    std::span<const std::uint32_t> indices);

// Returns the triangles that have an area, flipped such that no edge runs the same way in two
// faces; vertices at one place count as one. Nothing where that is impossible, as on a Moebius
// strip, or where three faces meet in an edge.
[[nodiscard]] std::optional<std::vector<std::uint32_t>> oriented_faces(
    std::span<const glm::vec3> positions, std::span<const std::uint32_t> indices);

}  // namespace penumbra
