// Computes missing normals and tangents, and splits edges to follow the lens distortion.
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

using TriangleCorners = std::array<glm::dvec3, 3>;

TriangleCorners corners_at(const Mesh& mesh, std::size_t first) {
  TriangleCorners corners;
  for (std::size_t k = 0; k < 3; ++k) {
    corners[k] = glm::dvec3(mesh.positions[mesh.indices[first + k]]);
  }
  return corners;
}

// Returns the angle at a corner [rad]; 0 if an adjacent edge has zero length.
double corner_angle(const TriangleCorners& p, std::size_t corner) {
  const glm::dvec3 a = p[(corner + 1) % 3] - p[corner];
  const glm::dvec3 b = p[(corner + 2) % 3] - p[corner];
  const double lengths = glm::length(a) * glm::length(b);
  if (!(lengths > 0.0)) return 0.0;
  return std::acos(std::clamp(glm::dot(a, b) / lengths, -1.0, 1.0));
}

// The result for (a, b) equals that for (b, a), so that an edge's two triangles split it alike.
float edge_length_squared(const glm::vec3& a, const glm::vec3& b) {
  const glm::vec3 d = a - b;
  return glm::dot(d, d);
}

template <class Vector>
Vector middle(const Vector& a, const Vector& b) {
  return a * 0.5F + b * 0.5F;
}

class Splitter {
 public:
  explicit Splitter(const Mesh& mesh) : mesh_(mesh) {}

  // Splits every edge longer than the threshold once, at its midpoint.
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
  // The ends may be adjacent floats, which have no midpoint.
  const glm::vec3 m = middle(a, b);
  return m != a && m != b;
}

std::uint32_t Splitter::middle_vertex(std::uint32_t i, std::uint32_t j) {
  const std::uint64_t key = (std::uint64_t{std::min(i, j)} << 32U) | std::max(i, j);
  const auto [entry, is_new] =
      middles_.try_emplace(key, static_cast<std::uint32_t>(mesh_.positions.size()));
  if (!is_new) return entry->second;
  const auto add_middle = [i, j](auto& values) {
    if (!values.empty()) values.push_back(middle(values[i], values[j]));
  };
  const auto unit = [](const glm::vec3& sum, const glm::vec3& fallback) {
    const float length = glm::length(sum);
    return length > 1e-6F ? sum / length : fallback;
  };
  add_middle(mesh_.positions);
  add_middle(mesh_.texcoords);
  add_middle(mesh_.texcoords_2);
  add_middle(mesh_.colors);
  mesh_.normals.push_back(unit(mesh_.normals[i] + mesh_.normals[j], mesh_.normals[i]));
  if (!mesh_.tangents.empty()) {
    const glm::vec4 a = mesh_.tangents[i];
    const glm::vec3 sum = glm::vec3(a) + glm::vec3(mesh_.tangents[j]);
    mesh_.tangents.emplace_back(unit(sum, glm::vec3(a)), a.w);
  }
  mesh_.source_vertex.push_back(mesh_.source_vertex[i]);
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
    // Rotates the corners: one cut is the edge v0-v1, two cuts are v0-v1 and v1-v2.
    std::ptrdiff_t first = 0;
    if (cuts == 2) first = cut[0] ? (cut[1] ? 0 : 2) : 1;
    if (cuts == 1) first = std::ranges::find(cut, true) - cut.begin();
    std::rotate(v.begin(), v.begin() + first, v.end());
    const std::uint32_t m01 = middle_vertex(v[0], v[1]);
    if (cuts == 1) {
      add(v[0], m01, v[2]);
      add(m01, v[1], v[2]);
      continue;
    }
    const std::uint32_t m12 = middle_vertex(v[1], v[2]);
    if (cuts == 2) {
      add(m01, v[1], m12);
      // Splits the quadrilateral v0, m01, m12, v2 along its shorter diagonal.
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
  mesh_.node_faces.clear();  // invalid for the new faces
}

}  // namespace

void generate_normals(Mesh& mesh) {
  std::vector<glm::dvec3> sums(mesh.positions.size(), glm::dvec3(0.0));
  for (std::size_t t = 0; t + 2 < mesh.indices.size(); t += 3) {
    const TriangleCorners p = corners_at(mesh, t);
    const glm::dvec3 normal = glm::cross(p[1] - p[0], p[2] - p[0]);
    const double length = glm::length(normal);
    if (!(length > 0.0)) continue;
    for (std::size_t k = 0; k < 3; ++k) {
      sums[mesh.indices[t + k]] += normal / length * corner_angle(p, k);
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

// The direction of a texture's x axis on a face; unknown if the face has no area in the texture.
// The layout is mirrored if the texture's y axis (towards smaller v) is clockwise of x.
struct FaceTangent {
  glm::dvec3 x{0.0};
  bool known = false, mirrored = false;
};

FaceTangent face_tangent(const Mesh& mesh, const std::vector<glm::vec2>& texcoords,
                         std::size_t first) {
  const TriangleCorners p = corners_at(mesh, first);
  std::array<glm::dvec2, 3> t;
  glm::dvec3 normal(0.0);
  for (std::size_t k = 0; k < 3; ++k) {
    const std::uint32_t i = mesh.indices[first + k];
    t[k] = glm::dvec2(texcoords[i]);
    normal += glm::dvec3(mesh.normals[i]);
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

// Returns an arbitrary tangent of the surface.
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
  std::vector<std::array<bool, 2>> used(count, {false, false});  // by unmirrored, by mirrored faces
  for (std::size_t f = 0; f < faces.size() && texcoords.size() == count; ++f) {
    faces[f] = face_tangent(mesh, texcoords, 3 * f);
    if (!faces[f].known) continue;
    const std::size_t side = faces[f].mirrored ? 1 : 0;
    const TriangleCorners p = corners_at(mesh, 3 * f);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t i = mesh.indices[3 * f + k];
      const glm::dvec3 n = glm::dvec3(mesh.normals[i]);
      const glm::dvec3 along = faces[f].x - n * glm::dot(n, faces[f].x);
      const double length = glm::length(along);
      used[i][side] = true;
      if (length > 1e-9) sums[i][side] += along * (corner_angle(p, k) / length);
    }
  }
  const auto tangent = [&mesh](std::size_t i, const glm::dvec3& sum, bool mirrored) {
    const glm::dvec3 n = glm::dvec3(mesh.normals[i]);
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
  // Duplicates vertices that mirrored and unmirrored faces share.
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
  // Keeps stored kernels only if every vertex has one.
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
    // Each split edge adds one triangle per adjacent face.
    const std::size_t budget = max_triangles - triangles;
    if (lengths.size() <= budget) {
      splitter.split(wanted);
      continue;
    }
    // Splits only as many of the longest edges as the budget allows.
    const auto last = lengths.begin() + static_cast<std::ptrdiff_t>(budget);
    std::nth_element(lengths.begin(), last, lengths.end(), std::greater<>());
    splitter.split(*last);
    break;
  }
  return std::move(splitter.mesh());
}

}  // namespace penumbra
