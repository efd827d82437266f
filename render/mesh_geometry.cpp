// Mesh -> mesh: normals where a file has none, and edges short enough to follow a curved lens.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <unordered_map>

#include "core/assert.hpp"
#include "render/model.hpp"
#include "render/model_parts.hpp"

namespace penumbra {
namespace {

glm::dvec3 to_double(const glm::vec3& v) {
  return {v.x, v.y, v.z};
}

// The angle between two edges that leave a corner [rad]; 0 where one has no length.
double corner_angle(const glm::dvec3& a, const glm::dvec3& b) {
  const double lengths = glm::length(a) * glm::length(b);
  if (!(lengths > 0.0)) return 0.0;
  return std::acos(std::clamp(glm::dot(a, b) / lengths, -1.0, 1.0));
}

// The same for both triangles at an edge, whichever way round they name it: no cracks.
float edge_length_squared(const glm::vec3& a, const glm::vec3& b) {
  const glm::vec3 d = a - b;
  return glm::dot(d, d);
}

glm::vec3 middle(const glm::vec3& a, const glm::vec3& b) {
  return a * 0.5F + b * 0.5F;
}

class Splitter {
 public:
  explicit Splitter(const Mesh& mesh) : mesh_(mesh) {}

  // One pass: splits every edge longer than the threshold in its middle.
  void split(float threshold_squared);
  [[nodiscard]] bool splits(std::uint32_t i, std::uint32_t j, float threshold_squared) const;
  [[nodiscard]] Mesh& mesh() { return mesh_; }

 private:
  [[nodiscard]] std::uint32_t middle_vertex(std::uint32_t i, std::uint32_t j);

  Mesh mesh_;
  std::unordered_map<std::uint64_t, std::uint32_t> middles_;
};

bool Splitter::splits(std::uint32_t i, std::uint32_t j, float threshold_squared) const {
  const glm::vec3& a = mesh_.positions[i];
  const glm::vec3& b = mesh_.positions[j];
  if (!(edge_length_squared(a, b) > threshold_squared)) return false;
  // Where float has no number between the ends there is nothing to split.
  const glm::vec3 m = middle(a, b);
  return m != a && m != b;
}

std::uint32_t Splitter::middle_vertex(std::uint32_t i, std::uint32_t j) {
  const std::uint64_t key = (std::uint64_t{std::min(i, j)} << 32U) | std::max(i, j);
  const auto [entry, is_new] =
      middles_.try_emplace(key, static_cast<std::uint32_t>(mesh_.positions.size()));
  if (is_new) {
    mesh_.positions.push_back(middle(mesh_.positions[i], mesh_.positions[j]));
    const glm::vec3 sum = mesh_.normals[i] + mesh_.normals[j];
    const float length = glm::length(sum);
    mesh_.normals.push_back(length > 1e-6F ? sum / length : mesh_.normals[i]);
    if (!mesh_.texcoords.empty()) {
      mesh_.texcoords.push_back(mesh_.texcoords[i] * 0.5F + mesh_.texcoords[j] * 0.5F);
    }
    if (!mesh_.colors.empty()) {
      mesh_.colors.push_back(mesh_.colors[i] * 0.5F + mesh_.colors[j] * 0.5F);
    }
    mesh_.source_vertex.push_back(mesh_.source_vertex[i]);
  }
  return entry->second;
}

void Splitter::split(float threshold_squared) {
  middles_.clear();
  std::vector<std::uint32_t> result;
  result.reserve(mesh_.indices.size() * 2);
  const auto add = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    result.insert(result.end(), {a, b, c});
  };
  for (std::size_t t = 0; t < mesh_.indices.size(); t += 3) {
    std::array<std::uint32_t, 3> v = {mesh_.indices[t], mesh_.indices[t + 1], mesh_.indices[t + 2]};
    std::array<bool, 3> cut{};  // cut[k]: the edge from v[k] to v[k + 1]
    int cuts = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      cut[k] = splits(v[k], v[(k + 1) % 3], threshold_squared);
      cuts += cut[k] ? 1 : 0;
    }
    if (cuts == 0) {
      add(v[0], v[1], v[2]);
      continue;
    }
    // Turned so that one cut is the edge v0-v1, two cuts are v0-v1 and v1-v2.
    std::size_t first = 0;
    if (cuts == 1) {
      while (!cut[first]) ++first;
    } else if (cuts == 2) {
      while (cut[(first + 2) % 3]) ++first;
    }
    v = {v[first % 3], v[(first + 1) % 3], v[(first + 2) % 3]};
    const std::uint32_t m01 = middle_vertex(v[0], v[1]);
    if (cuts == 1) {
      add(v[0], m01, v[2]);
      add(m01, v[1], v[2]);
      continue;
    }
    const std::uint32_t m12 = middle_vertex(v[1], v[2]);
    if (cuts == 2) {
      add(m01, v[1], m12);
      // The quadrilateral v0, m01, m12, v2 along its shorter diagonal.
      const std::vector<glm::vec3>& p = mesh_.positions;
      if (edge_length_squared(p[v[0]], p[m12]) <= edge_length_squared(p[m01], p[v[2]])) {
        add(v[0], m01, m12);
        add(v[0], m12, v[2]);
      } else {
        add(v[0], m01, v[2]);
        add(m01, m12, v[2]);
      }
      continue;
    }
    const std::uint32_t m20 = middle_vertex(v[2], v[0]);
    add(v[0], m01, m20);
    add(m01, v[1], m12);
    add(m20, m12, v[2]);
    add(m01, m12, m20);
  }
  mesh_.indices = std::move(result);
  mesh_.node_faces.clear();  // of other faces
}

}  // namespace

void generate_normals(Mesh& mesh) {
  std::vector<glm::dvec3> sums(mesh.positions.size(), glm::dvec3(0.0));
  for (std::size_t t = 0; t + 2 < mesh.indices.size(); t += 3) {
    std::array<glm::dvec3, 3> p;
    for (std::size_t k = 0; k < 3; ++k) p[k] = to_double(mesh.positions[mesh.indices[t + k]]);
    const glm::dvec3 normal = glm::cross(p[1] - p[0], p[2] - p[0]);
    const double length = glm::length(normal);
    if (!(length > 0.0)) continue;
    for (std::size_t k = 0; k < 3; ++k) {
      const double angle = corner_angle(p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
      sums[mesh.indices[t + k]] += normal / length * angle;
    }
  }
  mesh.normals.clear();
  mesh.normals.reserve(sums.size());
  for (const glm::dvec3& sum : sums) {
    const double length = glm::length(sum);
    mesh.normals.push_back(length > 1e-9 ? glm::vec3(sum / length) : glm::vec3(0.0F, 0.0F, 1.0F));
  }
}

void append_mesh(Mesh& mesh, const Mesh& more) {
  PENUMBRA_ASSERT(mesh.material == more.material);
  const std::size_t before = mesh.positions.size();
  const std::size_t after = before + more.positions.size();
  const auto append = [&](auto& to, const auto& from, const auto& absent) {
    if (to.empty() && from.empty()) return;
    to.resize(before, absent);
    to.insert(to.end(), from.begin(), from.end());
    to.resize(after, absent);
  };
  // Stored kernels are of use only where every vertex has one.
  if (mesh.shadow_kernels.size() == before && more.shadow_kernels.size() == more.positions.size()) {
    mesh.shadow_kernels.insert(mesh.shadow_kernels.end(), more.shadow_kernels.begin(),
                               more.shadow_kernels.end());
  } else {
    mesh.shadow_kernels.clear();
  }
  append(mesh.normals, more.normals, glm::vec3(0.0F, 0.0F, 1.0F));
  append(mesh.texcoords, more.texcoords, glm::vec2(0.0F));
  append(mesh.colors, more.colors, glm::vec4(1.0F));
  mesh.positions.insert(mesh.positions.end(), more.positions.begin(), more.positions.end());
  mesh.source_vertex.insert(mesh.source_vertex.end(), more.source_vertex.begin(),
                            more.source_vertex.end());
  for (NodeFaces run : more.node_faces) {
    run.first_index += mesh.indices.size();
    mesh.node_faces.push_back(run);
  }
  for (const std::uint32_t index : more.indices) {
    mesh.indices.push_back(static_cast<std::uint32_t>(before) + index);
  }
}

Mesh subdivided(const Mesh& mesh, float max_edge_m, std::size_t max_triangles) {
  PENUMBRA_ASSERT(max_edge_m > 0.0F);
  const float wanted = max_edge_m * max_edge_m;
  Splitter splitter(mesh);
  std::vector<float> lengths;
  while (true) {
    const Mesh& now = splitter.mesh();
    const std::size_t triangles = now.indices.size() / 3;
    lengths.clear();
    for (std::size_t t = 0; t < now.indices.size(); t += 3) {
      for (std::size_t k = 0; k < 3; ++k) {
        const std::uint32_t i = now.indices[t + k];
        const std::uint32_t j = now.indices[t + (k + 1) % 3];
        if (splitter.splits(i, j, wanted)) {
          lengths.push_back(edge_length_squared(now.positions[i], now.positions[j]));
        }
      }
    }
    if (lengths.empty() || triangles >= max_triangles) break;
    // Each cut edge adds one triangle on each of its sides.
    const std::size_t budget = max_triangles - triangles;
    if (lengths.size() <= budget) {
      splitter.split(wanted);
      continue;
    }
    // Not all: the longest ones, so many that the budget holds.
    const auto last = lengths.begin() + static_cast<std::ptrdiff_t>(budget);
    std::nth_element(lengths.begin(), last, lengths.end(), std::greater<>());
    splitter.split(*last);
    break;
  }
  return std::move(splitter.mesh());
}

}  // namespace penumbra
