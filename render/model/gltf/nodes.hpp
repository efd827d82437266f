// Reads the node hierarchy: transforms of nodes, instances and skins, and the visible meshes.
#pragma once

#include <tiny_gltf.h>

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/accessors.hpp"
#include "render/model/gltf/node_pose.hpp"
#include "render/model/model.hpp"

namespace penumbra::gltf {

// One mesh at one node.
struct Placement {
  int node = -1;  // -1: a file without nodes
  int mesh = -1;
  std::uint32_t model_node = 0;  // index into Model::nodes
  std::string json_path;         // JSON path of the node, and its name
};

class Nodes {
 public:
  Nodes(const tinygltf::Model& gltf, Accessors& accessors, Model& model)
      : gltf_(gltf), accessors_(accessors), model_(model) {}

  // Returns the visible meshes of the default scene, in its order. Adds its nodes to the model.
  [[nodiscard]] Result<std::vector<Placement>> visible_meshes();

  // Replaces the transforms of nodes, until the next call.
  [[nodiscard]] Result<void> set_poses(NodePoses poses);
  [[nodiscard]] Eigen::Matrix4d T_root_mesh(const Placement& placement) const {
    if (placement.node < 0) return Eigen::Matrix4d::Identity();
    return scene_nodes_[placement.model_node].T_root_node;
  }
  // Returns the pose of a node, or nullptr.
  [[nodiscard]] const NodePose* pose_of(int node) const {
    const auto pose = poses_.find(node);
    return pose == poses_.end() ? nullptr : &pose->second;
  }

  // Returns the transforms of a node's instances (EXT_mesh_gpu_instancing), or one identity if the
  // node has none. Fails if there are more than `max_count`.
  [[nodiscard]] Result<std::vector<Eigen::Matrix4d>> instances_of(int node, std::size_t max_count);

  // Returns T_root_joint times the inverse bind matrix for each joint of a skin
  // (glTF 2.0, 3.7.3.3). It transforms a vertex of the mesh to the root frame.
  [[nodiscard]] Result<const std::vector<Eigen::Matrix4d>*> joint_matrices(int skin);

 private:
  struct SceneNode {
    std::size_t node = 0;
    int parent = -1;  // index of an earlier SceneNode, or -1
    Eigen::Matrix4d T_root_node = Eigen::Matrix4d::Identity();
  };
  [[nodiscard]] Result<void> place(SceneNode& scene_node) const;
  [[nodiscard]] Result<void> walk(int node, int depth, int parent);
  std::uint32_t add_node(const std::string& node, int mesh, int parent);
  // Returns the parent of each node, -1 for roots.
  [[nodiscard]] std::vector<int> find_parents() const;
  [[nodiscard]] Result<Eigen::Matrix4d> node_transform(std::size_t node) const;
  // Applies the transforms of the node and its ancestors, which need not be in the scene.
  [[nodiscard]] Result<Eigen::Matrix4d> T_root_node(int node);
  // Returns the inverse bind matrices of a skin, which are read once.
  [[nodiscard]] Result<const std::vector<Eigen::Matrix4d>*> inverse_bind_matrices(
      int skin, const std::string& json_path);

  const tinygltf::Model& gltf_;
  Accessors& accessors_;
  Model& model_;
  NodePoses poses_;
  std::vector<bool> visited_;           // per node
  std::vector<SceneNode> scene_nodes_;  // one per Model::nodes, unless the file has no nodes
  std::vector<Placement> placements_;
  std::vector<int> parents_;  // find_parents(); empty until first needed
  std::vector<std::optional<Eigen::Matrix4d>> T_root_nodes_;
  std::map<int, std::vector<Eigen::Matrix4d>> inverse_bind_matrices_;  // per skin
  std::map<int, std::vector<Eigen::Matrix4d>> joint_matrices_;         // per skin
};

}  // namespace penumbra::gltf
