#include "render/model/gltf/placer.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "render/model/model_parts.hpp"
#include "render/model/to_eigen.hpp"

namespace penumbra::gltf {
namespace {

// The linear part of an affine transform.
struct LinearPart {
  Eigen::Matrix3d linear;
  // Transforms normals: determinant times transposed inverse, which exists even for singular
  // matrices. Scaled to a maximum entry of 1; negated if the transform mirrors.
  Eigen::Matrix3d cofactor;
  double determinant = 0.0;
  bool has_surface = false;  // false: surfaces become lines or points
};

LinearPart linear_part_of(const Eigen::Matrix4d& T) {
  LinearPart result;
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

class VertexTransformer {
 public:
  explicit VertexTransformer(const PlacedPrimitive& placed)
      : placed_(placed),
        base_(placed.primitive->mesh),
        is_skinned_(placed.placement.joint_matrices != nullptr &&
                    placed.primitive->skin.per_vertex > 0),
        is_morphed_(std::ranges::any_of(placed.morph_weights, [](double w) { return w != 0.0; })),
        rigid_(linear_part_of(placed.placement.T_root_mesh)) {}

  // Computes the values below. Returns false if a coordinate is not finite or too large.
  [[nodiscard]] bool measure(double max_coordinate);
  // Returns the transformed mesh, relative to `origin`. Requires measure().
  [[nodiscard]] Mesh mesh(const Eigen::Vector3d& origin) const;

  [[nodiscard]] const PlacedPrimitive& placed() const { return placed_; }
  [[nodiscard]] const Eigen::AlignedBox3d& bounds() const { return bounds_; }
  // Resolution of the file's float coordinates after the transform [m].
  [[nodiscard]] double step() const { return step_; }
  [[nodiscard]] bool has_surface() const { return has_surface_; }
  [[nodiscard]] bool is_point() const { return is_point_; }

 private:
  using Deltas = std::vector<glm::vec3> MorphTarget::*;
  [[nodiscard]] Eigen::Matrix4d transform(std::size_t vertex) const {
    const VertexPlacement& placement = placed_.placement;
    return is_skinned_ ? placed_.primitive->skin.blended(vertex, *placement.joint_matrices)
                       : placement.T_root_mesh;
  }
  [[nodiscard]] LinearPart linear_part(std::size_t vertex) const {
    return is_skinned_ ? linear_part_of(transform(vertex)) : rigid_;
  }
  // Adds the weighted displacements of the morph targets (glTF 2.0, 3.7.2.2).
  [[nodiscard]] Eigen::Vector3d morphed(const glm::vec3& base, std::size_t vertex,
                                        Deltas attribute) const;
  [[nodiscard]] Eigen::Vector3d position(const Eigen::Matrix4d& T, std::size_t vertex) const {
    const Eigen::Vector3d p = morphed(base_.positions[vertex], vertex, &MorphTarget::positions);
    return (T * Eigen::Vector4d(p.x(), p.y(), p.z(), 1.0)).head<3>();
  }
  [[nodiscard]] Eigen::Vector3d morphed_unit(const glm::vec3& base, std::size_t vertex,
                                             Deltas attribute) const {
    const Eigen::Vector3d sum = morphed(base, vertex, attribute);
    return is_morphed_ ? sum.stableNormalized() : sum;
  }
  void transform_normals(Mesh& mesh) const;
  void transform_tangents(Mesh& mesh) const;

  const PlacedPrimitive& placed_;
  const Mesh& base_;
  bool is_skinned_;
  bool is_morphed_;
  LinearPart rigid_;
  Eigen::AlignedBox3d bounds_;
  double step_ = 0.0;
  bool has_surface_ = false;
  bool is_point_ = true;
  std::size_t mirrored_ = 0;  // number of mirrored vertices
};

Eigen::Vector3d VertexTransformer::morphed(const glm::vec3& base, std::size_t vertex,
                                           Deltas attribute) const {
  Eigen::Vector3d sum = to_eigen(base);
  if (!is_morphed_) return sum;
  for (std::size_t t = 0; t < placed_.morph_weights.size(); ++t) {
    const std::vector<glm::vec3>& deltas = placed_.primitive->targets[t].*attribute;
    if (!deltas.empty()) sum += placed_.morph_weights[t] * to_eigen(deltas[vertex]);
  }
  return sum;
}

bool VertexTransformer::measure(double max_coordinate) {
  for (std::size_t i = 0; i < base_.positions.size(); ++i) {
    const Eigen::Matrix4d T = transform(i);
    const LinearPart turn = is_skinned_ ? linear_part_of(T) : rigid_;
    if (!T.allFinite() || !std::isfinite(turn.determinant)) return false;
    has_surface_ = has_surface_ || turn.has_surface;
    is_point_ = is_point_ && turn.linear.isZero(0.0);
    if (turn.determinant < 0.0) ++mirrored_;
    const Eigen::Vector3d placed = position(T, i);
    if (!(placed.cwiseAbs().maxCoeff() <= max_coordinate)) return false;
    bounds_.extend(placed);
    const double coordinate = to_eigen(base_.positions[i]).cwiseAbs().maxCoeff();
    step_ = std::max(step_, coordinate * turn.linear.cwiseAbs().maxCoeff() *
                                std::numeric_limits<float>::epsilon());
  }
  return true;
}

Mesh VertexTransformer::mesh(const Eigen::Vector3d& origin) const {
  Mesh mesh = base_;
  mesh.node_faces = {{placed_.node, 0, mesh.indices.size()}};
  for (std::uint32_t& source : mesh.source_vertex) source += placed_.placement.source_shift;
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const Eigen::Matrix4d T = transform(i);
    mesh.positions[i] = to_glm(position(T, i) - origin);
    if (mesh.shadow_kernels.empty()) continue;
    const glm::vec3& k = mesh.shadow_kernels[i];
    const Eigen::Vector4d kernel = T * Eigen::Vector4d(k.x, k.y, k.z, 1.0);
    mesh.shadow_kernels[i] = to_glm(kernel.head<3>() - origin);
  }
  // A mirroring transform reverses the winding of triangles. A skin counts as mirroring if most of
  // its vertices are mirrored.
  for (std::size_t i = 0; i + 2 < mesh.indices.size() && 2 * mirrored_ > mesh.positions.size();
       i += 3) {
    std::swap(mesh.indices[i + 1], mesh.indices[i + 2]);
  }
  transform_normals(mesh);
  transform_tangents(mesh);
  return mesh;
}

// Transforms normals; flattened vertices get normals computed from the transformed faces.
void VertexTransformer::transform_normals(Mesh& mesh) const {
  if (mesh.normals.empty() || (!is_skinned_ && rigid_.determinant == 0.0)) {
    generate_normals(mesh);
    mesh.tangents.clear();  // tangents require the file's normals (glTF 2.0, 3.7.2.1)
    return;
  }
  std::vector<std::size_t> flat;
  for (std::size_t i = 0; i < mesh.normals.size(); ++i) {
    const LinearPart turn = linear_part(i);
    const Eigen::Vector3d normal = morphed_unit(mesh.normals[i], i, &MorphTarget::normals);
    const Eigen::Vector3d turned = (turn.cofactor * normal).stableNormalized();
    if (is_skinned_ && (turn.determinant == 0.0 || turned.isZero(0.0))) flat.push_back(i);
    mesh.normals[i] = to_glm(turned);
  }
  if (flat.empty()) return;
  std::vector<glm::vec3> turned = std::move(mesh.normals);
  generate_normals(mesh);
  for (const std::size_t i : flat) turned[i] = mesh.normals[i];
  mesh.normals = std::move(turned);
}

void VertexTransformer::transform_tangents(Mesh& mesh) const {
  for (std::size_t i = 0; i < mesh.tangents.size(); ++i) {
    glm::vec4& t = mesh.tangents[i];
    const LinearPart turn = linear_part(i);
    const Eigen::Vector3d tangent = morphed_unit(glm::vec3(t), i, &MorphTarget::tangents);
    const Eigen::Vector3d turned = (turn.linear * tangent).stableNormalized();
    t = glm::vec4(to_glm(turned), turn.determinant < 0.0 ? -t.w : t.w);
  }
}

}  // namespace

bool keeps_surfaces(const Eigen::Matrix4d& T) {
  return linear_part_of(T).has_surface;
}

Result<void> Placer::collect(PlacedPrimitive placed) {
  const Mesh& mesh = placed.primitive->mesh;
  vertices_ += mesh.positions.size();
  triangles_ += mesh.indices.size() / 3;
  if (vertices_ > limits_.max_vertices || triangles_ > limits_.max_triangles) {
    return fail("{}: the model has more than the {} vertices or {} triangles allowed",
                placed.json_path, limits_.max_vertices, limits_.max_triangles);
  }
  if (!mesh.indices.empty()) collected_.push_back(std::move(placed));
  return {};
}

Result<void> Placer::place_all() {
  Eigen::AlignedBox3d bounds;
  std::vector<VertexTransformer> visible;
  for (const PlacedPrimitive& placed : collected_) {
    VertexTransformer transformer(placed);
    if (!transformer.measure(kMaxFileCoordinate)) {
      return fail("{}: a vertex lies farther than {:g} units of the file from the origin",
                  placed.json_path, kMaxFileCoordinate);
    }
    if (!transformer.has_surface()) {
      // A scale of 0 on all axes is valid and hides a node (glTF 2.0, 5.25).
      notes_.add("its scale leaves no surface to see; it is ignored", placed.json_path,
                 transformer.is_point());
      continue;
    }
    bounds.extend(transformer.bounds());
    file_step_ = std::max(file_step_, transformer.step());
    visible.push_back(transformer);
  }
  model_.origin = model_origin(bounds);
  for (const VertexTransformer& transformer : visible) {
    const Eigen::AlignedBox3d centred = transformer.bounds().translated(-model_.origin);
    if (std::max(centred.min().cwiseAbs().maxCoeff(), centred.max().cwiseAbs().maxCoeff()) >
        limits_.max_coordinate_m) {
      return fail("{}: a vertex lies farther than {} units of the file from the origin",
                  transformer.placed().json_path, limits_.max_coordinate_m);
    }
    add(transformer.mesh(model_.origin));
  }
  return {};
}

void Placer::add(Mesh mesh) {
  const Material& material = model_.materials[static_cast<std::size_t>(mesh.material)];
  if (material.normal_texture.image >= 0 && mesh.tangents.empty()) {
    const std::size_t before = mesh.positions.size();
    generate_tangents(mesh, material.normal_texture.texcoords == 1);
    vertices_ += mesh.positions.size() - before;
  }
  const auto [entry, is_new] = mesh_of_material_.try_emplace(mesh.material, model_.meshes.size());
  if (is_new) {
    model_.meshes.push_back(std::move(mesh));
  } else {
    append_mesh(model_.meshes[entry->second], mesh);
  }
}

}  // namespace penumbra::gltf
