// Pairs the edges of closed meshes and orients faces, for masks.
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <vector>

namespace penumbra {

// An edge that two faces share and traverse in opposite directions.
struct SharedEdge {
  std::uint32_t from = 0, to = 0;       // vertices
  std::uint32_t forward = 0, back = 0;  // faces that traverse the edge forwards, backwards
};
// Returns all edges of a closed mesh; nullopt if some edge is not traversed equally often in both
// directions. More than two faces at an edge are paired in any order.
[[nodiscard]] std::optional<std::vector<SharedEdge>> paired_edges(
    std::span<const std::uint32_t> indices);

// Returns the triangles with non-zero area, oriented such that two faces at an edge traverse it in
// opposite directions. Vertices at the same position count as one vertex. Returns nullopt if there
// is no such orientation (as on a Moebius strip) or if three faces share an edge.
[[nodiscard]] std::optional<std::vector<std::uint32_t>> oriented_faces(
    std::span<const glm::vec3> positions, std::span<const std::uint32_t> indices);

}  // namespace penumbra
