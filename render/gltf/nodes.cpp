// The node hierarchy: places meshes in the root frame.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "render/gltf/gltf_reader.hpp"
#include "render/model_parts.hpp"

namespace penumbra {

Result<Eigen::Matrix4d> GltfReader::node_matrix(const tinygltf::Node& node,
                                                const std::string& what) const {
  const auto shaped = [](const std::vector<double>& list, std::size_t size) {
    return (list.empty() || list.size() == size) &&
           std::all_of(list.begin(), list.end(), [](double x) { return std::isfinite(x); });
  };
  if (!shaped(node.matrix, 16) || !shaped(node.translation, 3) || !shaped(node.rotation, 4) ||
      !shaped(node.scale, 3)) {
    return fail("{}: {}: its transform has the wrong number of components", name_, what);
  }
  if (!node.matrix.empty()) {
    const Eigen::Matrix4d matrix = Eigen::Map<const Eigen::Matrix4d>(node.matrix.data());
    const Eigen::RowVector4d last = matrix.row(3);
    if ((last - Eigen::RowVector4d(0.0, 0.0, 0.0, 1.0)).cwiseAbs().maxCoeff() > 1e-6) {
      return fail("{}: {}/matrix: is not a placement in space (last row 0 0 0 1)", name_, what);
    }
    return matrix;
  }
  Eigen::Affine3d placement = Eigen::Affine3d::Identity();
  if (!node.translation.empty()) {
    placement.translate(Eigen::Map<const Eigen::Vector3d>(node.translation.data()));
  }
  if (!node.rotation.empty()) {
    const Eigen::Quaterniond rotation(node.rotation[3], node.rotation[0], node.rotation[1],
                                      node.rotation[2]);
    if (!(std::abs(rotation.norm() - 1.0) < 0.1)) {
      return fail("{}: {}/rotation: is not a unit quaternion", name_, what);
    }
    placement.rotate(rotation.normalized());
  }
  if (!node.scale.empty()) {
    placement.scale(Eigen::Map<const Eigen::Vector3d>(node.scale.data()));
  }
  return placement.matrix();
}

// What a mesh says of its `_SHADOW_KERNEL` attribute. The direction is in the mesh's own axes, as
// the attribute is.
void GltfReader::take_kernel_extras(const tinygltf::Value& extras, const Eigen::Matrix3d& linear,
                                    const std::string& what) {
  if (!extras.IsObject() || !extras.Has(std::string(kKernelUpKey))) return;
  const tinygltf::Value& up = extras.Get(std::string(kKernelUpKey));
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  bool usable = up.IsArray() && up.ArrayLen() == 3;
  for (int i = 0; usable && i < 3; ++i) {
    usable = up.Get(i).IsNumber();
    if (usable) direction[i] = up.Get(i).GetNumberAsDouble();
  }
  direction = (linear * direction).stableNormalized();
  if (!usable || !direction.allFinite() || !(direction.norm() > 0.5)) {
    model_.warnings.push_back(
        fmt::format("{}: {}: {} is no direction; its stored shadow kernels are not used", name_,
                    what, kKernelUpKey));
    return;
  }
  const glm::vec3 turned(static_cast<float>(direction.x()), static_cast<float>(direction.y()),
                         static_cast<float>(direction.z()));
  if (model_.shadow_kernel_up && glm::dot(turned, *model_.shadow_kernel_up) < 0.99999F) {
    model_.warnings.push_back(fmt::format(
        "{}: {}: its shadow kernels are for another direction than those of other meshes", name_,
        what));
    kernels_disagree_ = true;
  }
  model_.shadow_kernel_up = turned;
  if (extras.Has(std::string(kKernelGeometryKey)) &&
      extras.Get(std::string(kKernelGeometryKey)).IsString()) {
    model_.shadow_kernel_geometry = extras.Get(std::string(kKernelGeometryKey)).Get<std::string>();
  }
  if (!extras.Has(std::string(kKernelGroupsKey))) return;
  const tinygltf::Value& groups = extras.Get(std::string(kKernelGroupsKey));
  std::vector<std::string> names;
  for (std::size_t i = 0; groups.IsArray() && i < groups.ArrayLen(); ++i) {
    const tinygltf::Value& group = groups.Get(static_cast<int>(i));
    if (group.IsString()) names.push_back(group.Get<std::string>());
  }
  if (!groups.IsArray() || names.size() != groups.ArrayLen() || names.size() > kMaxGroups) {
    model_.warnings.push_back(fmt::format(
        "{}: {}: {} is no list of names; its parts are not joined", name_, what, kKernelGroupsKey));
    return;
  }
  model_.shadow_kernel_groups = std::move(names);
}

// Names of a node and of its mesh, -1 where it has none.
std::uint32_t GltfReader::add_node(const std::string& node, int mesh, int parent) {
  model_.nodes.push_back(
      {node, has(gltf_.meshes, mesh) ? gltf_.meshes[static_cast<std::size_t>(mesh)].name : "",
       parent});
  return static_cast<std::uint32_t>(model_.nodes.size() - 1);
}

Result<void> GltfReader::place_mesh(int index, const Eigen::Matrix4d& T_root_node,
                                    const std::string& what, std::uint32_t node) {
  if (!has(meshes_, index)) {
    return fail("{}: {}: names mesh {}, there are {}", name_, what, index, meshes_.size());
  }
  const Eigen::Matrix3d linear = T_root_node.topLeftCorner<3, 3>();
  const double determinant = linear.determinant();
  if (!T_root_node.allFinite() || !std::isfinite(determinant)) {
    return fail("{}: {}: its transform is not finite", name_, what);
  }
  // A mirroring turns triangles inside out: their winding is turned back. The normals follow the
  // cofactor matrix (det * inverse transposed), which also exists where the inverse does not.
  const bool mirrored = determinant < 0.0;
  Eigen::Matrix3d cofactor;
  cofactor << linear.col(1).cross(linear.col(2)), linear.col(2).cross(linear.col(0)),
      linear.col(0).cross(linear.col(1));
  if (mirrored) cofactor = -cofactor;
  const double cofactor_size = cofactor.cwiseAbs().maxCoeff();
  if (!(cofactor_size > 0.0)) {
    return fail(
        "{}: {}: its scale leaves no surface to see; give scales other than 0, or remove "
        "the node",
        name_, what);
  }
  cofactor /= cofactor_size;
  take_kernel_extras(gltf_.meshes[static_cast<std::size_t>(index)].extras, linear, what);
  for (const Mesh& from : meshes_[static_cast<std::size_t>(index)]) {
    placed_vertices_ += from.positions.size();
    placed_triangles_ += from.indices.size() / 3;
    if (placed_vertices_ > limits_.max_vertices || placed_triangles_ > limits_.max_triangles) {
      return fail("{}: {}: the model has more than the {} vertices or {} triangles allowed", name_,
                  what, limits_.max_vertices, limits_.max_triangles);
    }
    Mesh mesh = from;
    if (mesh.indices.empty()) continue;
    mesh.node_faces = {{node, 0, mesh.indices.size()}};
    for (glm::vec3& p : mesh.positions) {
      const Eigen::Vector4d placed = T_root_node * Eigen::Vector4d(p.x, p.y, p.z, 1.0);
      if (!(placed.head<3>().cwiseAbs().maxCoeff() <= limits_.max_coordinate_m)) {
        return fail("{}: {}: a vertex lies farther than {} m from the origin", name_, what,
                    limits_.max_coordinate_m);
      }
      p = {static_cast<float>(placed.x()), static_cast<float>(placed.y()),
           static_cast<float>(placed.z())};
    }
    for (glm::vec3& k : mesh.shadow_kernels) {
      const Eigen::Vector4d placed = T_root_node * Eigen::Vector4d(k.x, k.y, k.z, 1.0);
      k = {static_cast<float>(placed.x()), static_cast<float>(placed.y()),
           static_cast<float>(placed.z())};
    }
    if (mirrored) {
      for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
        std::swap(mesh.indices[i + 1], mesh.indices[i + 2]);
      }
    }
    if (mesh.normals.empty() || determinant == 0.0) {
      generate_normals(mesh);
      mesh.tangents.clear();  // they belong to the normals that are not there (glTF 2.0, 3.7.2.1)
    } else {
      for (glm::vec3& n : mesh.normals) {
        const Eigen::Vector3d turned =
            (cofactor * Eigen::Vector3d(n.x, n.y, n.z)).stableNormalized();
        n = {static_cast<float>(turned.x()), static_cast<float>(turned.y()),
             static_cast<float>(turned.z())};
      }
    }
    for (glm::vec4& t : mesh.tangents) {
      const Eigen::Vector3d turned = (linear * Eigen::Vector3d(t.x, t.y, t.z)).stableNormalized();
      t = {static_cast<float>(turned.x()), static_cast<float>(turned.y()),
           static_cast<float>(turned.z()), mirrored ? -t.w : t.w};
    }
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
  return {};
}

Result<void> GltfReader::place_node(int index, const Eigen::Matrix4d& T_root_parent, int depth,
                                    int parent) {
  const std::string what = fmt::format("nodes/{}", index);
  if (!has(gltf_.nodes, index)) {
    return fail("{}: {}: does not exist, there are {}", name_, what, gltf_.nodes.size());
  }
  if (depth > kMaxModelDepth) {
    return fail("{}: {}: is nested deeper than {} nodes", name_, what, kMaxModelDepth);
  }
  // glTF's nodes are trees: a node met twice is a cycle or has two parents.
  if (placed_[static_cast<std::size_t>(index)]) {
    return fail("{}: {}: hangs in the scene twice or inside itself", name_, what);
  }
  placed_[static_cast<std::size_t>(index)] = true;
  const tinygltf::Node& node = gltf_.nodes[static_cast<std::size_t>(index)];
  const Result<Eigen::Matrix4d> matrix = node_matrix(node, what);
  if (!matrix) return tl::unexpected(matrix.error());
  const Eigen::Matrix4d T_root_node = T_root_parent * *matrix;
  const std::uint32_t known = add_node(node.name, node.mesh, parent);
  if (node.mesh >= 0) {
    const Result<void> placed = place_mesh(
        node.mesh, T_root_node,
        node.name.empty() ? what : fmt::format("{} (\"{}\")", what, node.name.substr(0, 60)),
        known);
    if (!placed) return placed;
  }
  for (const int child : node.children) {
    const Result<void> placed = place_node(child, T_root_node, depth + 1, static_cast<int>(known));
    if (!placed) return placed;
  }
  return {};
}

Result<Model> GltfReader::read() {
  // Vertices quantised to integers need no special treatment; the rest would change the shape.
  for (const std::string& extension : gltf_.extensionsRequired) {
    if (extension != "KHR_mesh_quantization") {
      return fail("{}: needs the glTF extension {}, which can't be read; export without it", name_,
                  extension.substr(0, 80));
    }
  }
  model_.culls_back_faces = true;
  if (Result<void> done = read_materials(); !done) return tl::unexpected(done.error());
  if (Result<void> done = read_meshes(); !done) return tl::unexpected(done.error());
  placed_.assign(gltf_.nodes.size(), false);
  const Eigen::Matrix4d identity = Eigen::Matrix4d::Identity();
  if (!gltf_.scenes.empty()) {
    const int scene = std::max(gltf_.defaultScene, 0);
    if (!has(gltf_.scenes, scene)) {
      return fail("{}: scene: names scene {}, there are {}", name_, scene, gltf_.scenes.size());
    }
    for (const int node : gltf_.scenes[static_cast<std::size_t>(scene)].nodes) {
      if (Result<void> done = place_node(node, identity, 1); !done) {
        return tl::unexpected(done.error());
      }
    }
    if (kernels_disagree_) model_.shadow_kernel_up.reset();
    return std::move(model_);
  }
  // A file without scenes is a library: everything in it is taken.
  std::vector<bool> is_child(gltf_.nodes.size(), false);
  for (const tinygltf::Node& node : gltf_.nodes) {
    for (const int child : node.children) {
      if (has(gltf_.nodes, child)) is_child[static_cast<std::size_t>(child)] = true;
    }
  }
  for (std::size_t node = 0; node < gltf_.nodes.size(); ++node) {
    if (is_child[node]) continue;
    if (Result<void> done = place_node(static_cast<int>(node), identity, 1); !done) {
      return tl::unexpected(done.error());
    }
  }
  if (gltf_.nodes.empty()) {
    for (std::size_t mesh = 0; mesh < meshes_.size(); ++mesh) {
      const auto index = static_cast<int>(mesh);
      Result<void> done =
          place_mesh(index, identity, fmt::format("meshes/{}", mesh), add_node("", index, -1));
      if (!done) return tl::unexpected(done.error());
    }
  }
  if (kernels_disagree_) model_.shadow_kernel_up.reset();
  return std::move(model_);
}

}  // namespace penumbra
