// The edges of a model's faces, and which of them are visible as lines from a point: outlines and
// creases (docs/rendering.md#edges-without-multisampling).
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <limits>
#include <span>
#include <vector>

namespace penumbra {

// Triangles with one material. The arrays must outlive the call that they are passed to.
struct EdgeMeshPart {
  std::span<const glm::vec3> positions;    // object frame [m]
  std::span<const glm::vec3> normals;      // one per position, or empty: no creases
  std::span<const std::uint32_t> indices;  // three per face
  int material = 0;                        // edges between different materials are creases
  bool one_sided = false;                  // faces are drawn only from the front
};

// An edge as seen from a point. Its face lies on the left on the way `from` -> `to`.
struct SeenEdge {
  std::uint32_t from = 0, to = 0;  // indices into EdgeMesh::positions()
  std::uint32_t face = 0;          // the face, or one of both at a crease
  bool crease = false;  // both faces are seen; false: nothing of the mesh is on the right
};

class EdgeMesh {
 public:
  EdgeMesh() = default;
  // Faces with corners at equal positions share edges, also across parts.
  explicit EdgeMesh(std::span<const EdgeMeshPart> parts);

  // Moves the positions. Returns false, and does nothing, if the parts have other faces, or if
  // vertices that were at equal positions are not any more. Creases stay the same edges.
  [[nodiscard]] bool move(std::span<const EdgeMeshPart> parts);

  // Returns the edges seen from `eye`: a homogeneous point (x, y, z, 1) or direction towards it
  // (x, y, z, 0), object frame. Includes edges that are hidden by other faces. `creases`: false
  // returns outlines only.
  [[nodiscard]] std::vector<SeenEdge> seen_from(const glm::vec4& eye, bool creases) const;

  [[nodiscard]] std::span<const glm::vec3> positions() const { return positions_; }
  [[nodiscard]] std::span<const std::uint32_t> indices() const { return indices_; }
  // Normal of a face, towards its front, of any length.
  [[nodiscard]] glm::vec3 normal(std::uint32_t face) const {
    return {normal_x_[face], normal_y_[face], normal_z_[face]};
  }
  // +1 or -1: faces of a closed mesh have their fronts outside or inside; 0: the mesh is open.
  [[nodiscard]] int outward() const { return outward_; }

 private:
  static constexpr std::uint32_t kNoFace = std::numeric_limits<std::uint32_t>::max();
  struct Edge {
    std::uint32_t from = 0, to = 0;  // in the direction of the first face
    std::uint32_t first = 0, second = kNoFace;
    bool same_direction = false;  // both faces traverse the edge from -> to
    bool crease = false;
  };

  void pair_edges(std::span<const EdgeMeshPart> parts);
  void place_faces();

  std::vector<glm::vec3> positions_;
  std::vector<std::uint32_t> indices_;          // into positions_
  std::vector<std::uint32_t> vertex_position_;  // position of each vertex of the parts
  std::vector<std::uint32_t> vertex_indices_;   // the parts' indices, for move()
  std::vector<bool> one_sided_;                 // per face
  std::vector<Edge> edges_;
  // Plane of each face: (x, y, z) . p = offset.
  std::vector<float> normal_x_, normal_y_, normal_z_, offset_;
  int outward_ = 0;
};

// The edges of an object's surfaces. Null: it has none of that kind.
struct ObjectEdges {
  const EdgeMesh* opaque = nullptr;   // with depth
  const EdgeMesh* blended = nullptr;  // drawn without depth, after all others
};

}  // namespace penumbra
