// Converts the faces of an OBJ file to triangles and meshes.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <glm/geometric.hpp>
#include <limits>
#include <unordered_map>

#include "render/model/model_parts.hpp"
#include "render/model/obj_reader.hpp"
#include "render/model/polygon_splitter.hpp"
#include "render/model/to_eigen.hpp"

namespace penumbra {
namespace {

constexpr double kCreaseCosine = 0.7071;  // an edge between faces at over 45 degrees is sharp

struct ObjTriangles {
  std::vector<ObjCorner> corners;
  std::vector<std::uint32_t> face;  // face of each triangle
  // (triangle, normal of its face), sorted by triangle, for planar faces of over 4 corners: their
  // triangles may be too thin for a normal computed from the corners.
  std::vector<std::pair<std::size_t, glm::vec3>> normals;
};

// Splits the file's faces into triangles. Adds vertices where outlines intersect themselves.
class FaceSplitter {
 public:
  FaceSplitter(ObjFile& file, const Eigen::Vector3d& origin, LineWarnings& warnings)
      : file_(file), origin_(origin), warnings_(warnings) {}

  void add(std::uint32_t index);
  [[nodiscard]] ObjTriangles take() { return std::move(triangles_); }

 private:
  void add_corner(const AddedCorner& added);
  void add_triangle(const std::array<std::uint32_t, 3>& triangle, std::uint32_t face);

  ObjFile& file_;
  Eigen::Vector3d origin_;
  LineWarnings& warnings_;
  PolygonSplitter splitter_;
  std::vector<Eigen::Vector3d> outline_;
  std::vector<ObjCorner> corners_;  // corners of the current face, then added corners
  ObjTriangles triangles_;
};

void FaceSplitter::add_triangle(const std::array<std::uint32_t, 3>& triangle, std::uint32_t face) {
  for (const std::uint32_t corner : triangle) triangles_.corners.push_back(corners_[corner]);
  triangles_.face.push_back(face);
}

// Adds a vertex to the file, with the weighted mean of its parents' attributes.
void FaceSplitter::add_corner(const AddedCorner& added) {
  ObjCorner corner;
  corner.position = static_cast<std::int32_t>(file_.positions.size());
  file_.positions.push_back(added.position + origin_);
  glm::vec3 color(0.0F), normal(0.0F);
  glm::vec2 texcoord(0.0F);
  bool has_texcoord = true, has_normal = true;
  for (std::size_t i = 0; i < added.of_corners.size(); ++i) {
    const ObjCorner& from = corners_[added.of_corners[i]];
    const float weight = added.weights[i];
    if (!file_.colors.empty()) {
      color += weight * file_.colors[static_cast<std::size_t>(from.position)];
    }
    has_texcoord = has_texcoord && from.texcoord >= 0;
    has_normal = has_normal && from.normal >= 0;
    if (has_texcoord) texcoord += weight * file_.texcoords[static_cast<std::size_t>(from.texcoord)];
    if (has_normal) normal += weight * file_.normals[static_cast<std::size_t>(from.normal)];
  }
  if (!file_.colors.empty()) file_.colors.push_back(color);
  if (has_texcoord) {
    corner.texcoord = static_cast<std::int32_t>(file_.texcoords.size());
    file_.texcoords.push_back(texcoord);
  }
  if (has_normal && glm::length(normal) > 0.0F) {
    corner.normal = static_cast<std::int32_t>(file_.normals.size());
    file_.normals.push_back(normal);
  }
  corners_.push_back(corner);
}

void FaceSplitter::add(std::uint32_t index) {
  const ObjFace face = file_.faces[index];
  const auto first = file_.corners.begin() + static_cast<std::ptrdiff_t>(face.first_corner);
  corners_.assign(first, first + face.corner_count);
  if (face.corner_count == 3) return add_triangle({0, 1, 2}, index);
  outline_.clear();
  for (const ObjCorner& corner : corners_) {
    outline_.emplace_back(file_.positions[static_cast<std::size_t>(corner.position)] - origin_);
  }
  const PolygonSplit& split = splitter_.split(outline_);
  if (split.outcome == PolygonSplit::Outcome::too_intricate) {
    warnings_.add(face.line,
                  "a face crosses itself too often to be split into triangles and is skipped; "
                  "export it as triangles");
    return;
  }
  if (split.crosses_itself) {
    warnings_.add(face.line, "a face's outline crosses itself; all that it winds around is filled");
  }
  if (!split.is_flat) {
    warnings_.add(face.line, "a face is not flat; it is split as seen along its mean normal");
  }
  for (const AddedCorner& added : split.added) add_corner(added);
  for (const std::array<std::uint32_t, 3>& triangle : split.triangles) {
    if (face.corner_count > 4 && split.is_flat) {
      triangles_.normals.emplace_back(triangles_.face.size(), to_glm(split.normal));
    }
    add_triangle(triangle, index);
  }
}

// Computes a normal per corner. Smooths faces that share the vertex and meet at less
// than 45 degrees; sharper edges stay sharp.
std::vector<glm::vec3> creased_normals(const std::vector<glm::vec3>& positions,
                                       const ObjTriangles& triangles) {
  // At vertices with more faces, all faces are smoothed: comparing all pairs would be slow.
  constexpr std::uint32_t kMaxPairedFaces = 64;
  struct Corner {
    glm::dvec3 normal{0.0};  // unit
    double angle = 0.0;
  };
  const std::vector<ObjCorner>& corners = triangles.corners;
  const auto vertex = [&](std::size_t corner) {
    return static_cast<std::size_t>(corners[corner].position);
  };
  std::vector<Corner> by_corner(corners.size());
  std::vector<std::uint32_t> start(positions.size() + 1, 0);
  auto known = triangles.normals.begin();
  for (std::size_t t = 0; t < corners.size(); t += 3) {
    std::array<glm::dvec3, 3> p;
    for (std::size_t k = 0; k < 3; ++k) p[k] = glm::dvec3(positions[vertex(t + k)]);
    const glm::dvec3 area = glm::cross(p[1] - p[0], p[2] - p[0]);
    const double length = glm::length(area);
    glm::dvec3 normal = length > 0.0 ? area / length : glm::dvec3(0.0);
    if (known != triangles.normals.end() && known->first == t / 3) {
      normal = glm::dvec3(known->second);
      ++known;
    }
    for (std::size_t k = 0; k < 3; ++k) {
      ++start[vertex(t + k) + 1];
      const glm::dvec3 a = p[(k + 1) % 3] - p[k], b = p[(k + 2) % 3] - p[k];
      const double lengths = glm::length(a) * glm::length(b);
      if (!(lengths > 0.0) || normal == glm::dvec3(0.0)) continue;
      by_corner[t + k] = {normal, std::acos(std::clamp(glm::dot(a, b) / lengths, -1.0, 1.0))};
    }
  }
  for (std::size_t i = 1; i < start.size(); ++i) start[i] += start[i - 1];
  std::vector<std::uint32_t> at_vertex(corners.size());
  std::vector<std::uint32_t> next(start.begin(), start.end() - 1);
  for (std::size_t c = 0; c < corners.size(); ++c) {
    at_vertex[next[vertex(c)]++] = static_cast<std::uint32_t>(c);
  }
  std::vector<glm::vec3> normals(corners.size());
  for (std::size_t v = 0; v < positions.size(); ++v) {
    const bool smooths_all = start[v + 1] - start[v] > kMaxPairedFaces;
    glm::dvec3 sum(0.0);
    for (std::uint32_t i = start[v]; i < start[v + 1]; ++i) {
      const Corner& corner = by_corner[at_vertex[i]];
      if (!smooths_all || i == start[v]) {
        sum = glm::dvec3(0.0);
        for (std::uint32_t j = start[v]; j < start[v + 1]; ++j) {
          const Corner& other = by_corner[at_vertex[j]];
          if (smooths_all || glm::dot(corner.normal, other.normal) >= kCreaseCosine) {
            sum += other.normal * other.angle;
          }
        }
      }
      const double length = glm::length(sum);
      normals[at_vertex[i]] = length > 1e-9 ? glm::vec3(sum / length) : glm::vec3(corner.normal);
    }
  }
  return normals;
}

// Builds the mesh of one material. Corners with equal attributes share a vertex.
class MeshBuilder {
 public:
  std::uint32_t vertex(const ObjFile& file, const std::vector<glm::vec3>& positions,
                       const ObjCorner& corner, const glm::vec3& normal) {
    const auto source = static_cast<std::uint32_t>(corner.position);
    Key key = {source, static_cast<std::uint32_t>(corner.texcoord), 0, 0, 0};
    std::memcpy(key.data() + 2, &normal, 3 * sizeof(float));
    const auto [entry, is_new] =
        known_.try_emplace(key, static_cast<std::uint32_t>(mesh.positions.size()));
    if (!is_new) return entry->second;
    mesh.positions.push_back(positions[source]);
    mesh.normals.push_back(normal);
    mesh.source_vertex.push_back(source);
    if (!file.texcoords.empty()) {
      glm::vec2 texcoord(0.0F);
      if (corner.texcoord >= 0) {
        const glm::vec2& from = file.texcoords[static_cast<std::size_t>(corner.texcoord)];
        texcoord = {from.x, 1.0F - from.y};  // OBJ counts v from the image's bottom
      }
      mesh.texcoords.push_back(texcoord);
    }
    if (!file.colors.empty()) {
      const glm::vec3& color = file.colors[source];
      const auto to_linear = [](float c) { return linear_from_srgb(std::clamp(c, 0.0F, 1.0F)); };
      mesh.colors.emplace_back(to_linear(color.x), to_linear(color.y), to_linear(color.z), 1.0F);
    }
    return entry->second;
  }
  void add_triangle(const std::array<std::uint32_t, 3>& triangle, std::uint32_t node) {
    // Keeps degenerate faces, because their vertices belong to the model.
    std::vector<NodeFaces>& runs = mesh.node_faces;
    if (runs.empty() || runs.back().node != node) runs.push_back({node, mesh.indices.size(), 0});
    runs.back().index_count += triangle.size();
    mesh.indices.insert(mesh.indices.end(), triangle.begin(), triangle.end());
  }

  Mesh mesh;

 private:
  using Key = std::array<std::uint32_t, 5>;  // vertex, texture coordinate, bits of the normal
  struct Hash {
    std::size_t operator()(const Key& key) const {
      std::uint64_t h = 1469598103934665603ULL;  // FNV-1a
      for (const std::uint32_t word : key) h = (h ^ word) * 1099511628211ULL;
      return static_cast<std::size_t>(h ^ (h >> 32U));
    }
  };
  std::unordered_map<Key, std::uint32_t, Hash> known_;
};

Eigen::AlignedBox3d bounds_of(const ObjFile& file) {
  Eigen::AlignedBox3d box;
  for (const ObjCorner& corner : file.corners) {
    box.extend(file.positions[static_cast<std::size_t>(corner.position)]);
  }
  return box;
}

}  // namespace

Result<void> add_obj_meshes(Model& model, ObjFile& file, const std::vector<int>& materials,
                            LineWarnings& warnings, const ModelLimits& limits,
                            const std::string& name) {
  const Eigen::AlignedBox3d bounds = bounds_of(file);
  model.origin = model_origin(bounds);
  file.step = std::numeric_limits<double>::epsilon() * bounds.center().cwiseAbs().maxCoeff();
  FaceSplitter splitter(file, model.origin, warnings);
  for (std::uint32_t i = 0; i < file.faces.size(); ++i) splitter.add(i);
  const ObjTriangles triangles = splitter.take();
  if (triangles.face.size() > limits.max_triangles || file.positions.size() > limits.max_vertices) {
    return fail("{}: its faces make {} triangles with {} vertices, {} and {} are allowed", name,
                triangles.face.size(), file.positions.size(), limits.max_triangles,
                limits.max_vertices);
  }
  // Positions are floats from here on.
  std::vector<glm::vec3> positions(file.positions.size());
  for (std::size_t i = 0; i < positions.size(); ++i) {
    positions[i] = to_glm(file.positions[i] - model.origin);
  }
  const bool lacks_normals =
      std::ranges::any_of(triangles.corners, [](const ObjCorner& c) { return c.normal < 0; });
  const std::vector<glm::vec3> generated =
      lacks_normals ? creased_normals(positions, triangles) : std::vector<glm::vec3>{};
  std::map<int, MeshBuilder> builders;
  const auto plain = static_cast<int>(model.materials.size()) - 1;
  for (std::size_t t = 0; t < triangles.face.size(); ++t) {
    const ObjFace& face = file.faces[triangles.face[t]];
    MeshBuilder& builder =
        builders[face.material < 0 ? plain : materials[static_cast<std::size_t>(face.material)]];
    std::array<std::uint32_t, 3> triangle{};
    for (std::size_t k = 0; k < 3; ++k) {
      const ObjCorner& corner = triangles.corners[3 * t + k];
      triangle[k] =
          builder.vertex(file, positions, corner,
                         corner.normal >= 0 ? file.normals[static_cast<std::size_t>(corner.normal)]
                                            : generated[3 * t + k]);
    }
    builder.add_triangle(triangle, face.node);
  }
  for (auto& [material, builder] : builders) {
    builder.mesh.material = material;
    builder.mesh.name = model.materials[static_cast<std::size_t>(material)].name;
    model.meshes.push_back(std::move(builder.mesh));
  }
  model.source_vertex_count = static_cast<std::uint32_t>(file.positions.size());
  return {};
}

}  // namespace penumbra
