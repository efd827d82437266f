#include "render/model/gltf/nodes.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "core/propagate.hpp"
#include "render/model/gltf/extensions.hpp"
#include "render/model/model_parts.hpp"

namespace penumbra::gltf {
namespace {

bool is_hidden(const tinygltf::Node& node) {
  const auto visibility = node.extensions.find(kVisibility);
  if (visibility == node.extensions.end() || !visibility->second.Has("visible")) return false;
  const tinygltf::Value& visible = visibility->second.Get("visible");
  return visible.IsBool() && !visible.Get<bool>();
}

}  // namespace

Result<Eigen::Matrix4d> Nodes::node_transform(std::size_t index) const {
  const tinygltf::Node& node = gltf_.nodes[index];
  const auto shaped = [](const std::vector<double>& list, std::size_t size) {
    return (list.empty() || list.size() == size) &&
           std::all_of(list.begin(), list.end(), [](double x) { return std::isfinite(x); });
  };
  if (!shaped(node.matrix, 16) || !shaped(node.translation, 3) || !shaped(node.rotation, 4) ||
      !shaped(node.scale, 3)) {
    return fail("nodes/{}: its transform has the wrong number of components", index);
  }
  if (!node.matrix.empty()) {
    const Eigen::Matrix4d matrix = Eigen::Map<const Eigen::Matrix4d>(node.matrix.data());
    const Eigen::RowVector4d last = matrix.row(3);
    if ((last - Eigen::RowVector4d(0.0, 0.0, 0.0, 1.0)).cwiseAbs().maxCoeff() > 1e-6) {
      return fail("nodes/{}/matrix: is not an affine transform (last row 0 0 0 1)", index);
    }
    return matrix;
  }
  NodePose pose;
  if (const NodePose* animated = pose_of(static_cast<int>(index))) pose = *animated;
  if (!pose.translation && !node.translation.empty())
    pose.translation = Eigen::Map<const Eigen::Vector3d>(node.translation.data());
  if (!pose.rotation && !node.rotation.empty()) {
    pose.rotation = rotation_of(node.rotation.data());
    if (!pose.rotation) return fail("nodes/{}/rotation: is not a unit quaternion", index);
  }
  if (!pose.scale && !node.scale.empty())
    pose.scale = Eigen::Map<const Eigen::Vector3d>(node.scale.data());
  Eigen::Affine3d placement = Eigen::Affine3d::Identity();
  if (pose.translation) placement.translate(*pose.translation);
  if (pose.rotation) placement.rotate(*pose.rotation);
  if (pose.scale) placement.scale(*pose.scale);
  return placement.matrix();
}

// `mesh`: index, or -1 for a node without mesh.
std::uint32_t Nodes::add_node(const std::string& node, int mesh, int parent) {
  model_.nodes.push_back(
      {node, has(gltf_.meshes, mesh) ? gltf_.meshes[static_cast<std::size_t>(mesh)].name : "",
       parent});
  return static_cast<std::uint32_t>(model_.nodes.size() - 1);
}

Result<void> Nodes::place(SceneNode& scene_node) const {
  PENUMBRA_TRY(const Eigen::Matrix4d T_parent_node, node_transform(scene_node.node));
  Eigen::Matrix4d T_root_parent = Eigen::Matrix4d::Identity();
  if (scene_node.parent >= 0)
    T_root_parent = scene_nodes_[static_cast<std::size_t>(scene_node.parent)].T_root_node;
  scene_node.T_root_node = T_root_parent * T_parent_node;
  return {};
}

Result<void> Nodes::set_poses(NodePoses poses) {
  poses_ = std::move(poses);
  T_root_nodes_.assign(T_root_nodes_.size(), std::nullopt);
  joint_matrices_.clear();
  for (SceneNode& scene_node : scene_nodes_) PENUMBRA_TRY_VOID(place(scene_node));
  return {};
}

Result<void> Nodes::walk(int index, int depth, int parent) {
  const std::string what = fmt::format("nodes/{}", index);
  if (!has(gltf_.nodes, index)) {
    return fail("{}: does not exist, there are {}", what, gltf_.nodes.size());
  }
  if (depth > kMaxModelDepth) {
    return fail("{}: is nested deeper than {} nodes", what, kMaxModelDepth);
  }
  // glTF nodes form trees. A node visited twice is in a cycle or has two parents.
  const auto i = static_cast<std::size_t>(index);
  if (visited_[i]) {
    return fail("{}: has two parents or is its own ancestor; export the scene as a tree", what);
  }
  visited_[i] = true;
  const tinygltf::Node& node = gltf_.nodes[i];
  if (is_hidden(node)) return {};
  scene_nodes_.push_back({i, parent});
  PENUMBRA_TRY_VOID(place(scene_nodes_.back()));
  const std::uint32_t model_node = add_node(node.name, node.mesh, parent);
  if (node.mesh >= 0) {
    if (!has(gltf_.meshes, node.mesh)) {
      return fail("{}: names mesh {}, there are {}", what, node.mesh, gltf_.meshes.size());
    }
    placements_.push_back(
        {index, node.mesh, model_node,
         node.name.empty() ? what : fmt::format("{} (\"{}\")", what, node.name.substr(0, 60))});
  }
  for (const int child : node.children) {
    PENUMBRA_TRY_VOID(walk(child, depth + 1, static_cast<int>(model_node)));
  }
  return {};
}

std::vector<int> Nodes::find_parents() const {
  std::vector<int> parents(gltf_.nodes.size(), -1);
  for (std::size_t parent = 0; parent < gltf_.nodes.size(); ++parent) {
    for (const int child : gltf_.nodes[parent].children) {
      if (has(gltf_.nodes, child)) {
        parents[static_cast<std::size_t>(child)] = static_cast<int>(parent);
      }
    }
  }
  return parents;
}

Result<std::vector<Placement>> Nodes::visible_meshes() {
  visited_.assign(gltf_.nodes.size(), false);
  std::vector<int> shown;
  if (gltf_.scenes.empty()) {
    // In a file without scenes, all root nodes are visible.
    const std::vector<int> parents = find_parents();
    for (std::size_t node = 0; node < parents.size(); ++node) {
      if (parents[node] < 0) shown.push_back(static_cast<int>(node));
    }
  } else {
    const int scene = std::max(gltf_.defaultScene, 0);
    if (!has(gltf_.scenes, scene)) {
      return fail("scene: names scene {}, there are {}", scene, gltf_.scenes.size());
    }
    shown = gltf_.scenes[static_cast<std::size_t>(scene)].nodes;
  }
  for (const int node : shown) {
    PENUMBRA_TRY_VOID(walk(node, 1, -1));
  }
  if (gltf_.scenes.empty() && gltf_.nodes.empty()) {
    for (std::size_t mesh = 0; mesh < gltf_.meshes.size(); ++mesh) {
      const auto index = static_cast<int>(mesh);
      placements_.push_back({-1, index, add_node("", index, -1), fmt::format("meshes/{}", mesh)});
    }
  }
  return std::move(placements_);
}

Result<Eigen::Matrix4d> Nodes::T_root_node(int node) {
  if (parents_.empty()) {
    parents_ = find_parents();
    T_root_nodes_.resize(gltf_.nodes.size());
  }
  std::vector<std::size_t> chain;  // from the node up to its first ancestor with a known transform
  int next = node;
  while (next >= 0 && !T_root_nodes_[static_cast<std::size_t>(next)]) {
    if (chain.size() > static_cast<std::size_t>(kMaxModelDepth)) {
      return fail("nodes/{}: is nested deeper than {} nodes", node, kMaxModelDepth);
    }
    chain.push_back(static_cast<std::size_t>(next));
    next = parents_[static_cast<std::size_t>(next)];
  }
  Eigen::Matrix4d T_root_node = next < 0 ? Eigen::Matrix4d(Eigen::Matrix4d::Identity())
                                         : *T_root_nodes_[static_cast<std::size_t>(next)];
  while (!chain.empty()) {
    PENUMBRA_TRY(const Eigen::Matrix4d T_parent_node, node_transform(chain.back()));
    T_root_node = T_root_node * T_parent_node;
    T_root_nodes_[chain.back()] = T_root_node;
    chain.pop_back();
  }
  return T_root_node;
}

Result<std::vector<Eigen::Matrix4d>> Nodes::instances_of(int index, std::size_t max_count) {
  const tinygltf::Node& node = gltf_.nodes[static_cast<std::size_t>(index)];
  const std::string json_path = fmt::format("nodes/{}", index);
  const auto extension = node.extensions.find(kInstancing);
  std::map<std::string, int> attributes;
  if (extension != node.extensions.end() && extension->second.Has("attributes")) {
    const tinygltf::Value& list = extension->second.Get("attributes");
    for (const std::string& key : list.Keys()) {
      if (list.Get(key).IsInt()) attributes[key] = list.Get(key).GetNumberAsInt();
    }
  }
  const std::string what = fmt::format("{}/extensions/{}/attributes", json_path, kInstancing);
  PENUMBRA_TRY(const Elements translations,
               accessors_.attribute(attributes, "TRANSLATION", {3, 3, 0}, what));
  PENUMBRA_TRY(const Elements rotations,
               accessors_.attribute(attributes, "ROTATION", {4, 4, 0}, what));
  PENUMBRA_TRY(const Elements scales, accessors_.attribute(attributes, "SCALE", {3, 3, 0}, what));
  const std::size_t count = std::max({translations.count, rotations.count, scales.count});
  if (count == 0) return std::vector<Eigen::Matrix4d>{Eigen::Matrix4d::Identity()};
  for (const Elements* elements : {&translations, &rotations, &scales}) {
    if (elements->count != 0 && elements->count != count) {
      return fail("{}: have {} and {} elements", what, elements->count, count);
    }
  }
  if (count > max_count) {
    return fail("{}: has {} instances; {} of this mesh can be read", json_path, count, max_count);
  }
  const auto vector_of = [](const Elements& elements, std::size_t i) {
    return Eigen::Map<const Eigen::Vector3d>(&elements.values[3 * i]);
  };
  std::vector<Eigen::Matrix4d> instances;
  for (std::size_t i = 0; i < count; ++i) {
    Eigen::Affine3d instance = Eigen::Affine3d::Identity();
    if (translations.count > 0) instance.translate(vector_of(translations, i));
    if (rotations.count > 0) {
      const auto rotation = rotation_of(&rotations.values[4 * i]);
      if (!rotation) return fail("{}/ROTATION: element {} is not a unit quaternion", what, i);
      instance.rotate(*rotation);
    }
    if (scales.count > 0) instance.scale(vector_of(scales, i));
    instances.push_back(instance.matrix());
  }
  return instances;
}

Result<const std::vector<Eigen::Matrix4d>*> Nodes::inverse_bind_matrices(
    int index, const std::string& json_path) {
  if (const auto known = inverse_bind_matrices_.find(index); known != inverse_bind_matrices_.end())
    return &known->second;
  const tinygltf::Skin& skin = gltf_.skins[static_cast<std::size_t>(index)];
  std::vector<Eigen::Matrix4d> matrices(skin.joints.size(), Eigen::Matrix4d::Identity());
  if (skin.inverseBindMatrices < 0) return &(inverse_bind_matrices_[index] = std::move(matrices));
  const std::string what = json_path + "/inverseBindMatrices";
  PENUMBRA_TRY(const Elements elements, accessors_.elements(skin.inverseBindMatrices, what));
  const int type = accessors_.find(skin.inverseBindMatrices)->componentType;
  if (elements.width != 16 || type != TINYGLTF_COMPONENT_TYPE_FLOAT) {
    return fail("{}: are not 4 x 4 matrices of floats", what);
  }
  if (elements.count < matrices.size()) {
    return fail("{}: are {} for {} joints", what, elements.count, matrices.size());
  }
  for (std::size_t i = 0; i < matrices.size(); ++i) {
    matrices[i] = Eigen::Map<const Eigen::Matrix4d>(elements.values.data() + 16 * i);
    const Eigen::RowVector4d expected(0.0, 0.0, 0.0, 1.0);
    if ((matrices[i].row(3) - expected).cwiseAbs().maxCoeff() > 1e-4) {
      return fail("{}: matrix {} is not an affine transform (last row 0 0 0 1)", what, i);
    }
    matrices[i].row(3) = expected;
  }
  return &(inverse_bind_matrices_[index] = std::move(matrices));
}

Result<const std::vector<Eigen::Matrix4d>*> Nodes::joint_matrices(int index) {
  const std::string json_path = fmt::format("skins/{}", index);
  if (const auto known = joint_matrices_.find(index); known != joint_matrices_.end())
    return &known->second;
  const tinygltf::Skin& skin = gltf_.skins[static_cast<std::size_t>(index)];
  if (skin.joints.empty()) return fail("{}: has no joints", json_path);
  for (const int joint : skin.joints) {
    if (!has(gltf_.nodes, joint)) {
      return fail("{}/joints: names node {}, there are {}", json_path, joint, gltf_.nodes.size());
    }
  }
  PENUMBRA_TRY(const auto inverse, inverse_bind_matrices(index, json_path));
  std::vector<Eigen::Matrix4d> matrices(inverse->size());
  for (std::size_t i = 0; i < matrices.size(); ++i) {
    PENUMBRA_TRY(const Eigen::Matrix4d T_root_joint, T_root_node(skin.joints[i]));
    matrices[i] = T_root_joint * (*inverse)[i];
    if (!matrices[i].allFinite()) {
      return fail("{}: the transform of joint {} is not finite", json_path, i);
    }
  }
  return &(joint_matrices_[index] = std::move(matrices));
}

}  // namespace penumbra::gltf
