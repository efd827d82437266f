#include "render/gltf/place.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "render/gltf/skins.hpp"
#include "render/model_parts.hpp"

namespace penumbra::gltf {
namespace {

// The linear part of an affine transform.
struct Orientation {
  Eigen::Matrix3d linear;
  // Normals follow the cofactor matrix (det * inverse transposed), which also exists where the
  // inverse does not. Scaled to a largest entry of 1; turned back where the transform mirrors.
  Eigen::Matrix3d cofactor;
  double determinant = 0.0;
  bool has_surface = false;  // false: surfaces become lines or points
};

Orientation orientation_of(const Eigen::Matrix4d& T) {
  Orientation result;
  result.linear = T.topLeftCorner<3, 3>();
  const Eigen::Matrix3d& linear = result.linear;
  result.determinant = linear.determinant();
  result.cofactor << linear.col(1).cross(linear.col(2)), linear.col(2).cross(linear.col(0)),
      linear.col(0).cross(linear.col(1));
  if (result.determinant < 0.0) result.cofactor = -result.cofactor;
  const double size = result.cofactor.cwiseAbs().maxCoeff();
  result.has_surface = size > 0.0;
  if (result.has_surface) result.cofactor /= size;
  return result;
}

glm::vec3 single(const Eigen::Vector3d& v) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
}

// Places a mesh vertex by vertex.
class PlacedMesh {
 public:
  PlacedMesh(const Primitive& primitive, const VertexPlacement& placement)
      : mesh(primitive.mesh),
        primitive_(primitive),
        placement_(placement),
        is_skinned_(placement.joint_matrices != nullptr && primitive.skin.per_vertex > 0),
        rigid_(orientation_of(placement.T_root_mesh)) {}

  // False where a coordinate is too large or not a number.
  [[nodiscard]] bool place_vertices(double max_coordinate);
  void turn_windings();
  void turn_normals();
  void turn_tangents();

  [[nodiscard]] bool has_surface() const { return has_surface_; }
  [[nodiscard]] bool is_point() const { return is_point_; }

  Mesh mesh;

 private:
  [[nodiscard]] Eigen::Matrix4d transform(std::size_t vertex) const {
    return is_skinned_ ? blended(primitive_.skin, vertex, *placement_.joint_matrices)
                       : placement_.T_root_mesh;
  }
  [[nodiscard]] Orientation orientation(std::size_t vertex) const {
    return is_skinned_ ? orientation_of(transform(vertex)) : rigid_;
  }

  const Primitive& primitive_;
  const VertexPlacement& placement_;
  bool is_skinned_;
  Orientation rigid_;
  bool has_surface_ = false;
  bool is_point_ = true;
  std::size_t mirrored_ = 0;  // vertices
};

bool PlacedMesh::place_vertices(double max_coordinate) {
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const Eigen::Matrix4d T = transform(i);
    const Orientation turn = is_skinned_ ? orientation_of(T) : rigid_;
    if (!T.allFinite() || !std::isfinite(turn.determinant)) return false;
    has_surface_ = has_surface_ || turn.has_surface;
    is_point_ = is_point_ && turn.linear.isZero(0.0);
    if (turn.determinant < 0.0) ++mirrored_;
    glm::vec3& p = mesh.positions[i];
    const Eigen::Vector4d placed = T * Eigen::Vector4d(p.x, p.y, p.z, 1.0);
    if (!(placed.head<3>().cwiseAbs().maxCoeff() <= max_coordinate)) return false;
    p = single(placed.head<3>());
    if (mesh.shadow_kernels.empty()) continue;
    glm::vec3& k = mesh.shadow_kernels[i];
    k = single((T * Eigen::Vector4d(k.x, k.y, k.z, 1.0)).head<3>());
  }
  return true;
}

// A mirroring turns triangles inside out: their winding is turned back. A skin mirrors where most
// of its vertices are mirrored.
void PlacedMesh::turn_windings() {
  if (2 * mirrored_ <= mesh.positions.size()) return;
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    std::swap(mesh.indices[i + 1], mesh.indices[i + 2]);
  }
}

// Vertices that a transform flattens get the normals of the placed faces.
void PlacedMesh::turn_normals() {
  if (mesh.normals.empty() || (!is_skinned_ && rigid_.determinant == 0.0)) {
    generate_normals(mesh);
    mesh.tangents.clear();  // they belong to the normals that are not there (glTF 2.0, 3.7.2.1)
    return;
  }
  bool is_flat = false;
  std::vector<bool> flat(mesh.normals.size(), false);
  for (std::size_t i = 0; i < mesh.normals.size(); ++i) {
    glm::vec3& n = mesh.normals[i];
    const Orientation turn = orientation(i);
    const Eigen::Vector3d turned =
        (turn.cofactor * Eigen::Vector3d(n.x, n.y, n.z)).stableNormalized();
    flat[i] = is_skinned_ && (turn.determinant == 0.0 || turned.isZero(0.0));
    is_flat = is_flat || flat[i];
    n = single(turned);
  }
  if (!is_flat) return;
  std::vector<glm::vec3> turned = std::move(mesh.normals);
  generate_normals(mesh);
  for (std::size_t i = 0; i < turned.size(); ++i) {
    if (!flat[i]) mesh.normals[i] = turned[i];
  }
}

void PlacedMesh::turn_tangents() {
  for (std::size_t i = 0; i < mesh.tangents.size(); ++i) {
    glm::vec4& t = mesh.tangents[i];
    const Orientation turn = orientation(i);
    const Eigen::Vector3d turned =
        (turn.linear * Eigen::Vector3d(t.x, t.y, t.z)).stableNormalized();
    t = glm::vec4(single(turned), turn.determinant < 0.0 ? -t.w : t.w);
  }
}

}  // namespace

void apply_morph_targets(Mesh& mesh, const std::vector<MorphTarget>& targets,
                         const std::vector<double>& weights) {
  const bool any = std::ranges::any_of(weights, [](double weight) { return weight != 0.0; });
  if (!any) return;
  const std::size_t count = std::min(targets.size(), weights.size());
  // The sum over the targets, in double.
  const auto moved = [&](glm::dvec3 sum, std::size_t vertex,
                         std::vector<glm::vec3> MorphTarget::*attribute) {
    for (std::size_t t = 0; t < count; ++t) {
      const std::vector<glm::vec3>& deltas = targets[t].*attribute;
      if (!deltas.empty()) sum += weights[t] * glm::dvec3(deltas[vertex]);
    }
    return sum;
  };
  const auto unit = [](const glm::dvec3& v) {
    const double length = glm::length(v);
    return length > 0.0 && std::isfinite(length) ? v / length : glm::dvec3(0.0);
  };
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    mesh.positions[i] = glm::vec3(moved(glm::dvec3(mesh.positions[i]), i, &MorphTarget::positions));
  }
  for (std::size_t i = 0; i < mesh.normals.size(); ++i) {
    mesh.normals[i] = glm::vec3(unit(moved(glm::dvec3(mesh.normals[i]), i, &MorphTarget::normals)));
  }
  for (std::size_t i = 0; i < mesh.tangents.size(); ++i) {
    const glm::vec4 t = mesh.tangents[i];
    const glm::dvec3 base(t.x, t.y, t.z);
    mesh.tangents[i] = glm::vec4(glm::vec3(unit(moved(base, i, &MorphTarget::tangents))), t.w);
  }
}

Result<void> Placer::count(const Mesh& mesh, const std::string& what) {
  placed_vertices_ += mesh.positions.size();
  placed_triangles_ += mesh.indices.size() / 3;
  if (placed_vertices_ > limits_.max_vertices || placed_triangles_ > limits_.max_triangles) {
    return fail("{}: {}: the model has more than the {} vertices or {} triangles allowed", name_,
                what, limits_.max_vertices, limits_.max_triangles);
  }
  return {};
}

Result<void> Placer::place(const Primitive& primitive, const std::vector<double>& weights,
                           const VertexPlacement& placement, std::uint32_t node,
                           const std::string& what) {
  if (Result<void> done = count(primitive.mesh, what); !done) return done;
  if (primitive.mesh.indices.empty()) return {};
  PlacedMesh placed(primitive, placement);
  Mesh& mesh = placed.mesh;
  mesh.node_faces = {{node, 0, mesh.indices.size()}};
  apply_morph_targets(mesh, primitive.targets, weights);
  if (!placed.place_vertices(limits_.max_coordinate_m)) {
    return fail("{}: {}: a vertex lies farther than {} m from the origin", name_, what,
                limits_.max_coordinate_m);
  }
  if (!placed.has_surface()) {
    // A scale of 0 on all axes is the way to hide a node (glTF 2.0, 5.25).
    notes_.add("its scale leaves no surface to see; it is ignored", what, placed.is_point());
    return {};
  }
  placed.turn_windings();
  placed.turn_normals();
  placed.turn_tangents();
  add(std::move(mesh));
  return {};
}

void Placer::add(Mesh mesh) {
  const Material& material = model_.materials[static_cast<std::size_t>(mesh.material)];
  if (material.normal_texture.image >= 0 && mesh.tangents.empty()) {
    const std::size_t before = mesh.positions.size();
    generate_tangents(mesh, material.normal_texture.texcoords == 1);
    placed_vertices_ += mesh.positions.size() - before;
  }
  const auto [entry, is_new] = mesh_of_material_.try_emplace(mesh.material, model_.meshes.size());
  if (is_new) {
    model_.meshes.push_back(std::move(mesh));
  } else {
    append_mesh(model_.meshes[entry->second], mesh);
  }
}

}  // namespace penumbra::gltf
