#include "render/edges/edge_mesh.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <glm/geometric.hpp>
#include <tuple>
#include <unordered_map>
#include <utility>

namespace penumbra {
namespace {

// Normals that differ by more than 15 degrees make a crease. Flatter edges change the brightness
// less, and there are many (docs/rendering.md#edges-without-multisampling).
constexpr float kSmoothCosine = 0.9659F;

struct PositionHash {
  std::size_t operator()(const glm::vec3& p) const {
    std::size_t hash = 0;
    for (const float value : {p.x, p.y, p.z})
      hash = (hash ^ std::bit_cast<std::uint32_t>(value)) * 0x9E3779B97F4A7C15ULL;
    return hash ^ (hash >> 32U);
  }
};

bool differ(const glm::vec3& a, const glm::vec3& b) {
  return glm::dot(a, b) < kSmoothCosine;
}

}  // namespace

EdgeMesh::EdgeMesh(std::span<const EdgeMeshPart> parts) {
  std::unordered_map<glm::vec3, std::uint32_t, PositionHash> known;
  for (const EdgeMeshPart& part : parts) {
    const auto first = static_cast<std::uint32_t>(vertex_position_.size());
    for (const glm::vec3& p : part.positions) {
      const glm::vec3 key = p + glm::vec3(0.0F);  // -0 becomes 0
      const auto next = static_cast<std::uint32_t>(positions_.size());
      const auto [found, is_new] = known.try_emplace(key, next);
      if (is_new) positions_.push_back(key);
      vertex_position_.push_back(found->second);
    }
    for (std::size_t i = 0; i + 2 < part.indices.size(); i += 3) {
      one_sided_.push_back(part.one_sided);
      for (std::size_t corner = 0; corner < 3; ++corner) {
        vertex_indices_.push_back(first + part.indices[i + corner]);
        indices_.push_back(vertex_position_[vertex_indices_.back()]);
      }
    }
  }
  pair_edges(parts);
  place_faces();
}

void EdgeMesh::pair_edges(std::span<const EdgeMeshPart> parts) {
  std::vector<glm::vec3> normals;
  std::vector<int> materials;  // of each face
  for (const EdgeMeshPart& part : parts) {
    if (part.normals.size() == part.positions.size()) {
      normals.insert(normals.end(), part.normals.begin(), part.normals.end());
    } else {
      normals.resize(normals.size() + part.positions.size(), glm::vec3(0.0F));
    }
    materials.resize(materials.size() + part.indices.size() / 3, part.material);
  }
  struct Half {
    std::uint32_t low, high, face;
    std::uint32_t at_low, at_high;  // vertices
    bool forward;                   // from low to high
  };
  std::vector<Half> halves;
  halves.reserve(indices_.size());
  for (std::size_t i = 0; i < indices_.size(); i += 3) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const std::size_t at = i + corner;
      const std::size_t next = i + (corner + 1) % 3;
      const std::uint32_t a = indices_[at];
      const std::uint32_t b = indices_[next];
      if (a == b) continue;
      const bool forward = a < b;
      halves.push_back({std::min(a, b), std::max(a, b), static_cast<std::uint32_t>(i / 3),
                        vertex_indices_[forward ? at : next], vertex_indices_[forward ? next : at],
                        forward});
    }
  }
  std::ranges::sort(halves, [](const Half& a, const Half& b) {
    return std::tie(a.low, a.high, a.face) < std::tie(b.low, b.high, b.face);
  });
  bool closed = true;
  for (std::size_t i = 0; i < halves.size();) {
    std::size_t end = i + 1;
    while (end < halves.size() && halves[end].low == halves[i].low &&
           halves[end].high == halves[i].high)
      ++end;
    const auto edge_of = [](const Half& half) {
      return Edge{half.forward ? half.low : half.high, half.forward ? half.high : half.low,
                  half.face};
    };
    if (end - i == 2) {
      const Half& a = halves[i];
      const Half& b = halves[i + 1];
      Edge edge = edge_of(a);
      edge.second = b.face;
      edge.same_direction = a.forward == b.forward;
      closed = closed && !edge.same_direction;
      edge.crease = materials[a.face] != materials[b.face] ||
                    differ(normals[a.at_low], normals[b.at_low]) ||
                    differ(normals[a.at_high], normals[b.at_high]);
      if (edge.crease && normals[a.at_low] == glm::vec3(0.0F) &&
          materials[a.face] == materials[b.face])
        edge.crease = false;  // no normals
      edges_.push_back(edge);
    } else {
      closed = false;
      for (std::size_t k = i; k < end; ++k) edges_.push_back(edge_of(halves[k]));
    }
    i = end;
  }
  outward_ = closed && !edges_.empty() ? 1 : 0;
}

void EdgeMesh::place_faces() {
  const std::size_t count = indices_.size() / 3;
  for (auto* values : {&normal_x_, &normal_y_, &normal_z_, &offset_}) values->resize(count);
  double volume = 0.0;
  for (std::size_t face = 0; face < count; ++face) {
    const glm::vec3& a = positions_[indices_[3 * face]];
    const glm::vec3 n =
        glm::cross(positions_[indices_[3 * face + 1]] - a, positions_[indices_[3 * face + 2]] - a);
    normal_x_[face] = n.x;
    normal_y_[face] = n.y;
    normal_z_[face] = n.z;
    offset_[face] = glm::dot(n, a);
    volume += static_cast<double>(offset_[face]);
  }
  if (outward_ != 0) outward_ = volume < 0.0 ? -1 : 1;
}

bool EdgeMesh::move(std::span<const EdgeMeshPart> parts) {
  std::size_t vertices = 0;
  std::size_t corners = 0;
  for (const EdgeMeshPart& part : parts) {
    const auto first = static_cast<std::uint32_t>(vertices);
    if (corners + part.indices.size() > vertex_indices_.size()) return false;
    for (const std::uint32_t index : part.indices) {
      if (vertex_indices_[corners++] != first + index) return false;
    }
    vertices += part.positions.size();
  }
  if (vertices != vertex_position_.size() || corners != vertex_indices_.size()) return false;
  std::vector<glm::vec3> moved(positions_.size());
  std::vector<bool> is_moved(positions_.size());
  std::size_t vertex = 0;
  for (const EdgeMeshPart& part : parts) {
    for (const glm::vec3& p : part.positions) {
      const std::uint32_t at = vertex_position_[vertex++];
      if (is_moved[at] && moved[at] != p) return false;
      moved[at] = p;
      is_moved[at] = true;
    }
  }
  positions_ = std::move(moved);
  place_faces();
  return true;
}

std::vector<SeenEdge> EdgeMesh::seen_from(const glm::vec4& eye, bool creases) const {
  std::vector<SeenEdge> seen;
  const std::size_t count = offset_.size();
  std::vector<std::uint8_t> front(count);
  for (std::size_t face = 0; face < count; ++face) {
    const float side = normal_x_[face] * eye.x + normal_y_[face] * eye.y + normal_z_[face] * eye.z -
                       offset_[face] * eye.w;
    front[face] = side > 0.0F ? 1 : 0;
  }
  const std::uint8_t visible_side = outward_ < 0 ? 0 : 1;
  for (const Edge& edge : edges_) {
    const std::uint8_t of_first = front[edge.first];
    const bool boundary = edge.second == kNoFace;
    if (!boundary) {
      const bool outline = (of_first != front[edge.second]) != edge.same_direction;
      if (!outline) {
        if (!creases || !edge.crease) continue;
        // The far side of a closed mesh is hidden, and so are the backs of one-sided faces.
        if (of_first != visible_side && (outward_ != 0 || one_sided_[edge.first])) continue;
        seen.push_back({edge.from, edge.to, edge.first, true});
        if (of_first == 0) std::swap(seen.back().from, seen.back().to);
        continue;
      }
    } else if (of_first == 0 && one_sided_[edge.first]) {
      continue;
    }
    // The face in front, where there is one: it hides the other one.
    const std::uint32_t face = boundary || of_first == visible_side ? edge.first : edge.second;
    seen.push_back({edge.from, edge.to, face, false});
    if (of_first == 0) std::swap(seen.back().from, seen.back().to);
  }
  return seen;
}

}  // namespace penumbra
