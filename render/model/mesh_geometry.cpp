// Mesh -> mesh: normals where a file has none, and edges short enough to follow a curved lens.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <unordered_map>

#include "core/assert.hpp"
#include "render/model/model.hpp"
#include "render/model/model_parts.hpp"

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
    if (!mesh_.texcoords_2.empty()) {
      mesh_.texcoords_2.push_back(mesh_.texcoords_2[i] * 0.5F + mesh_.texcoords_2[j] * 0.5F);
    }
    if (!mesh_.tangents.empty()) {
      const glm::vec4& a = mesh_.tangents[i];
      const glm::vec3 both = glm::vec3(a) + glm::vec3(mesh_.tangents[j]);
      const float size = glm::length(both);
      mesh_.tangents.push_back(size > 1e-6F ? glm::vec4(both / size, a.w) : a);
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

namespace {

// Where the texture's x points on a face, and whether the layout is mirrored there: its y, up in
// the picture and so towards smaller v, is not a quarter turn anticlockwise from x. Nothing where
// the layout has no area.
struct FaceTangent {
  glm::dvec3 x{0.0};
  bool known = false, mirrored = false;
};

FaceTangent face_tangent(const Mesh& mesh, const std::vector<glm::vec2>& texcoords,
                         std::size_t first) {
  std::array<glm::dvec3, 3> p;
  std::array<glm::dvec2, 3> t;
  glm::dvec3 normal(0.0);
  for (std::size_t k = 0; k < 3; ++k) {
    const std::uint32_t i = mesh.indices[first + k];
    p[k] = to_double(mesh.positions[i]);
    t[k] = glm::dvec2(texcoords[i]);
    normal += to_double(mesh.normals[i]);
  }
  const glm::dvec2 d1 = t[1] - t[0];
  const glm::dvec2 d2 = t[2] - t[0];
  const double area = d1.x * d2.y - d2.x * d1.y;
  const glm::dvec3 along_u = (p[1] - p[0]) * d2.y - (p[2] - p[0]) * d1.y;  // times the area
  const glm::dvec3 along_v = (p[2] - p[0]) * d1.x - (p[1] - p[0]) * d2.x;
  const double length = glm::length(along_u);
  FaceTangent face;
  if (area == 0.0 || !(length > 0.0) || !std::isfinite(length)) return face;
  const double sign = area > 0.0 ? 1.0 : -1.0;
  face.known = true;
  face.x = along_u * (sign / length);
  face.mirrored = glm::dot(glm::cross(normal, face.x), along_v * -sign) < 0.0;
  return face;
}

// Any direction along the surface.
glm::dvec3 some_tangent(const glm::dvec3& normal) {
  const glm::dvec3 axis =
      std::abs(normal.x) < 0.9 ? glm::dvec3(1.0, 0.0, 0.0) : glm::dvec3(0.0, 1.0, 0.0);
  return axis - normal * glm::dot(normal, axis);
}

}  // namespace

void generate_tangents(Mesh& mesh, bool second) {
  PENUMBRA_ASSERT(mesh.normals.size() == mesh.positions.size());
  const std::vector<glm::vec2>& texcoords = second ? mesh.texcoords_2 : mesh.texcoords;
  const std::size_t count = mesh.positions.size();
  std::vector<FaceTangent> faces(mesh.indices.size() / 3);
  std::vector<std::array<glm::dvec3, 2>> sums(count, {glm::dvec3(0.0), glm::dvec3(0.0)});
  std::vector<std::array<bool, 2>> used(count, {false, false});  // plain, mirrored
  for (std::size_t f = 0; f < faces.size() && texcoords.size() == count; ++f) {
    faces[f] = face_tangent(mesh, texcoords, 3 * f);
    if (!faces[f].known) continue;
    const std::size_t side = faces[f].mirrored ? 1 : 0;
    std::array<glm::dvec3, 3> p;
    for (std::size_t k = 0; k < 3; ++k) p[k] = to_double(mesh.positions[mesh.indices[3 * f + k]]);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t i = mesh.indices[3 * f + k];
      const glm::dvec3 n = to_double(mesh.normals[i]);
      const glm::dvec3 along = faces[f].x - n * glm::dot(n, faces[f].x);
      const double length = glm::length(along);
      used[i][side] = true;
      if (length > 1e-9) {
        const double angle = corner_angle(p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
        sums[i][side] += along * (angle / length);
      }
    }
  }
  const auto tangent = [&mesh](std::size_t i, const glm::dvec3& sum, bool mirrored) {
    const glm::dvec3 n = to_double(mesh.normals[i]);
    const glm::dvec3 along = glm::length(sum) > 1e-9 ? sum : some_tangent(n);
    const double length = glm::length(along);
    return length > 1e-12 ? glm::vec4(glm::vec3(along / length), mirrored ? -1.0F : 1.0F)
                          : glm::vec4(1.0F, 0.0F, 0.0F, 1.0F);
  };
  mesh.tangents.clear();
  for (std::size_t i = 0; i < count; ++i) {
    const bool mirrored = used[i][1] && !used[i][0];
    mesh.tangents.push_back(tangent(i, sums[i][mirrored ? 1 : 0], mirrored));
  }
  // Where both meet, the mirrored faces get a vertex of their own.
  std::vector<std::uint32_t> twin(count, 0);
  const auto repeat = [](auto& values, std::size_t i, std::size_t size) {
    if (values.size() == size) values.push_back(values[i]);
  };
  for (std::size_t f = 0; f < faces.size(); ++f) {
    if (!faces[f].mirrored) continue;
    for (std::size_t k = 0; k < 3; ++k) {
      std::uint32_t& index = mesh.indices[3 * f + k];
      const std::size_t i = index;
      if (!used[i][0]) continue;
      if (twin[i] == 0) {
        const std::size_t size = mesh.positions.size();
        twin[i] = static_cast<std::uint32_t>(size);
        repeat(mesh.normals, i, size);
        repeat(mesh.texcoords, i, size);
        repeat(mesh.texcoords_2, i, size);
        repeat(mesh.colors, i, size);
        repeat(mesh.source_vertex, i, size);
        repeat(mesh.shadow_kernels, i, size);
        mesh.tangents.push_back(tangent(i, sums[i][1], true));
        repeat(mesh.positions, i, size);
      }
      index = twin[i];
    }
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
  append(mesh.texcoords_2, more.texcoords_2, glm::vec2(0.0F));
  append(mesh.tangents, more.tangents, glm::vec4(1.0F, 0.0F, 0.0F, 1.0F));
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
