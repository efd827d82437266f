#include "render/model/gltf/nodes.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>

#include "core/propagate.hpp"
#include "render/model/gltf/extensions.hpp"
#include "render/model/model_parts.hpp"

namespace penumbra::gltf {
namespace {

Result<Eigen::Matrix4d> node_matrix(const std::string& name, const tinygltf::Node& node,
                                    const std::string& what) {
  const auto shaped = [](const std::vector<double>& list, std::size_t size) {
    return (list.empty() || list.size() == size) &&
           std::all_of(list.begin(), list.end(), [](double x) { return std::isfinite(x); });
  };
  if (!shaped(node.matrix, 16) || !shaped(node.translation, 3) || !shaped(node.rotation, 4) ||
      !shaped(node.scale, 3)) {
    return fail("{}: {}: its transform has the wrong number of components", name, what);
  }
  if (!node.matrix.empty()) {
    const Eigen::Matrix4d matrix = Eigen::Map<const Eigen::Matrix4d>(node.matrix.data());
    const Eigen::RowVector4d last = matrix.row(3);
    if ((last - Eigen::RowVector4d(0.0, 0.0, 0.0, 1.0)).cwiseAbs().maxCoeff() > 1e-6) {
      return fail("{}: {}/matrix: is not a placement in space (last row 0 0 0 1)", name, what);
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
      return fail("{}: {}/rotation: is not a unit quaternion", name, what);
    }
    placement.rotate(rotation.normalized());
  }
  if (!node.scale.empty()) {
    placement.scale(Eigen::Map<const Eigen::Vector3d>(node.scale.data()));
  }
  return placement.matrix();
}

bool is_hidden(const tinygltf::Node& node) {
  const auto visibility = node.extensions.find(kVisibility);
  if (visibility == node.extensions.end() || !visibility->second.Has("visible")) return false;
  const tinygltf::Value& visible = visibility->second.Get("visible");
  return visible.IsBool() && !visible.Get<bool>();
}

}  // namespace

Pose rest_pose(const std::string& name, const tinygltf::Model& gltf) {
  Pose pose;
  for (std::size_t i = 0; i < gltf.nodes.size(); ++i) {
    pose.T_parent_node.push_back(node_matrix(name, gltf.nodes[i], fmt::format("nodes/{}", i)));
    pose.morph_weights.push_back(gltf.nodes[i].weights);
  }
  return pose;
}

// Names of a node and of its mesh, -1 where it has none.
std::uint32_t Nodes::add_node(const std::string& node, int mesh, int parent) {
  model_.nodes.push_back(
      {node, has(gltf_.meshes, mesh) ? gltf_.meshes[static_cast<std::size_t>(mesh)].name : "",
       parent});
  return static_cast<std::uint32_t>(model_.nodes.size() - 1);
}

Result<void> Nodes::walk(int index, const Eigen::Matrix4d& T_root_parent, int depth, int parent) {
  const std::string what = fmt::format("nodes/{}", index);
  if (!has(gltf_.nodes, index)) {
    return fail("{}: {}: does not exist, there are {}", name_, what, gltf_.nodes.size());
  }
  if (depth > kMaxModelDepth) {
    return fail("{}: {}: is nested deeper than {} nodes", name_, what, kMaxModelDepth);
  }
  // glTF's nodes are trees: a node met twice is a cycle or has two parents.
  const auto i = static_cast<std::size_t>(index);
  if (met_[i])
    return fail("{}: {}: has two parents or is its own ancestor; export the scene as a tree", name_,
                what);
  met_[i] = true;
  const tinygltf::Node& node = gltf_.nodes[i];
  if (is_hidden(node)) return {};
  const Result<Eigen::Matrix4d>& matrix = pose_.T_parent_node[i];
  if (!matrix) return tl::unexpected(matrix.error());
  const Eigen::Matrix4d T_root_node = T_root_parent * *matrix;
  const std::uint32_t known = add_node(node.name, node.mesh, parent);
  if (node.mesh >= 0) {
    if (!has(gltf_.meshes, node.mesh)) {
      return fail("{}: {}: names mesh {}, there are {}", name_, what, node.mesh,
                  gltf_.meshes.size());
    }
    placements_.push_back(
        {index, node.mesh, T_root_node, known,
         node.name.empty() ? what : fmt::format("{} (\"{}\")", what, node.name.substr(0, 60))});
  }
  for (const int child : node.children) {
    const Result<void> done = walk(child, T_root_node, depth + 1, static_cast<int>(known));
    if (!done) return done;
  }
  return {};
}

// A file without scenes is a library: everything in it is taken.
std::vector<int> Nodes::roots() const {
  std::vector<bool> is_child(gltf_.nodes.size(), false);
  for (const tinygltf::Node& node : gltf_.nodes) {
    for (const int child : node.children) {
      if (has(gltf_.nodes, child)) is_child[static_cast<std::size_t>(child)] = true;
    }
  }
  std::vector<int> roots;
  for (std::size_t node = 0; node < gltf_.nodes.size(); ++node) {
    if (!is_child[node]) roots.push_back(static_cast<int>(node));
  }
  return roots;
}

Result<std::vector<Placement>> Nodes::visible_meshes() {
  met_.assign(gltf_.nodes.size(), false);
  std::vector<int> shown;
  if (gltf_.scenes.empty()) {
    shown = roots();
  } else {
    const int scene = std::max(gltf_.defaultScene, 0);
    if (!has(gltf_.scenes, scene)) {
      return fail("{}: scene: names scene {}, there are {}", name_, scene, gltf_.scenes.size());
    }
    shown = gltf_.scenes[static_cast<std::size_t>(scene)].nodes;
  }
  for (const int node : shown) {
    PENUMBRA_TRY_VOID(walk(node, Eigen::Matrix4d::Identity(), 1, -1));
  }
  if (gltf_.scenes.empty() && gltf_.nodes.empty()) {
    for (std::size_t mesh = 0; mesh < gltf_.meshes.size(); ++mesh) {
      const auto index = static_cast<int>(mesh);
      placements_.push_back({-1, index, Eigen::Matrix4d::Identity(), add_node("", index, -1),
                             fmt::format("meshes/{}", mesh)});
    }
  }
  return std::move(placements_);
}

Result<Eigen::Matrix4d> Nodes::T_root_node(int node) {
  if (parents_.empty()) {
    parents_.assign(gltf_.nodes.size(), -1);
    T_root_nodes_.resize(gltf_.nodes.size());
    for (std::size_t parent = 0; parent < gltf_.nodes.size(); ++parent) {
      for (const int child : gltf_.nodes[parent].children) {
        if (has(gltf_.nodes, child)) {
          parents_[static_cast<std::size_t>(child)] = static_cast<int>(parent);
        }
      }
    }
  }
  std::vector<std::size_t> chain;  // from the node up to the first ancestor whose place is known
  int next = node;
  while (next >= 0 && !T_root_nodes_[static_cast<std::size_t>(next)]) {
    if (chain.size() > static_cast<std::size_t>(kMaxModelDepth)) {
      return fail("{}: nodes/{}: is nested deeper than {} nodes", name_, node, kMaxModelDepth);
    }
    chain.push_back(static_cast<std::size_t>(next));
    next = parents_[static_cast<std::size_t>(next)];
  }
  Eigen::Matrix4d T_root_node = next < 0 ? Eigen::Matrix4d(Eigen::Matrix4d::Identity())
                                         : *T_root_nodes_[static_cast<std::size_t>(next)];
  while (!chain.empty()) {
    const Result<Eigen::Matrix4d>& matrix = pose_.T_parent_node[chain.back()];
    if (!matrix) return matrix;
    T_root_node = T_root_node * *matrix;
    T_root_nodes_[chain.back()] = T_root_node;
    chain.pop_back();
  }
  return T_root_node;
}

Result<std::vector<Eigen::Matrix4d>> instances_of(const std::string& name,
                                                  const tinygltf::Node& node,
                                                  const std::string& place, Accessors& accessors,
                                                  std::size_t most) {
  const auto extension = node.extensions.find(kInstancing);
  std::map<std::string, int> attributes;
  if (extension != node.extensions.end() && extension->second.Has("attributes")) {
    const tinygltf::Value& list = extension->second.Get("attributes");
    for (const std::string& key : list.Keys()) {
      if (list.Get(key).IsInt()) attributes[key] = list.Get(key).GetNumberAsInt();
    }
  }
  const std::string what = fmt::format("{}/extensions/{}/attributes", place, kInstancing);
  PENUMBRA_TRY(const Elements translations,
               accessors.attribute(attributes, "TRANSLATION", {3, 3, 0}, what));
  PENUMBRA_TRY(const Elements rotations,
               accessors.attribute(attributes, "ROTATION", {4, 4, 0}, what));
  PENUMBRA_TRY(const Elements scales, accessors.attribute(attributes, "SCALE", {3, 3, 0}, what));
  const std::size_t count = std::max({translations.count, rotations.count, scales.count});
  std::vector<Eigen::Matrix4d> instances;
  if (count == 0) {
    instances.emplace_back(Eigen::Matrix4d::Identity());
    return instances;
  }
  for (const Elements* elements : {&translations, &rotations, &scales}) {
    if (elements->count != 0 && elements->count != count) {
      return fail("{}: {}: have {} and {} elements", name, what, elements->count, count);
    }
  }
  if (count > most) {
    return fail("{}: {}: has {} instances; {} of this mesh can be read", name, place, count, most);
  }
  const auto vector_of = [](const Elements& elements, std::size_t i) {
    return Eigen::Vector3d(elements.at(i, 0), elements.at(i, 1), elements.at(i, 2));
  };
  for (std::size_t i = 0; i < count; ++i) {
    Eigen::Affine3d instance = Eigen::Affine3d::Identity();
    if (translations.count > 0) instance.translate(vector_of(translations, i));
    if (rotations.count > 0) {
      const Eigen::Quaterniond rotation(rotations.at(i, 3), rotations.at(i, 0), rotations.at(i, 1),
                                        rotations.at(i, 2));
      if (!(std::abs(rotation.norm() - 1.0) < 0.1)) {
        return fail("{}: {}/ROTATION: element {} is not a unit quaternion", name, what, i);
      }
      instance.rotate(rotation.normalized());
    }
    if (scales.count > 0) instance.scale(vector_of(scales, i));
    instances.push_back(instance.matrix());
  }
  return instances;
}

}  // namespace penumbra::gltf
