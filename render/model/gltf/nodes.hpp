// The node hierarchy: transforms of nodes, and the meshes that are visible.
#pragma once

#include <tiny_gltf.h>

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/accessors.hpp"
#include "render/model/gltf/notes.hpp"
#include "render/model/model.hpp"

namespace penumbra::gltf {

// The state that an animation changes: a transform and morph weights per node.
struct Pose {
  std::vector<Result<Eigen::Matrix4d>> T_parent_node;
  std::vector<std::vector<double>> morph_weights;  // empty: those of the mesh
};

// The pose that the nodes of a file have without animation.
[[nodiscard]] Pose rest_pose(const std::string& name, const tinygltf::Model& gltf);

// One mesh at one node.
struct Placement {
  int node = -1;  // -1: a file without nodes
  int mesh = -1;
  Eigen::Matrix4d T_root_node = Eigen::Matrix4d::Identity();
  std::uint32_t model_node = 0;  // index into Model::nodes
  std::string place;             // of the node in the file, with its name
};

class Nodes {
 public:
  Nodes(std::string name, const tinygltf::Model& gltf, const Pose& pose, Model& model)
      : name_(std::move(name)), gltf_(gltf), pose_(pose), model_(model) {}

  // Returns the visible meshes of the default scene, in its order. Adds its nodes to the model.
  [[nodiscard]] Result<std::vector<Placement>> visible_meshes();

  // Returns the transform of a node by its ancestors, inside or outside the scene.
  [[nodiscard]] Result<Eigen::Matrix4d> T_root_node(int node);

 private:
  [[nodiscard]] Result<void> walk(int node, const Eigen::Matrix4d& T_root_parent, int depth,
                                  int parent);
  [[nodiscard]] std::vector<int> roots() const;
  std::uint32_t add_node(const std::string& node, int mesh, int parent);

  std::string name_;
  const tinygltf::Model& gltf_;
  const Pose& pose_;
  Model& model_;
  std::vector<bool> met_;  // per node
  std::vector<Placement> placements_;
  std::vector<int> parents_;  // per node, -1 of roots; made when first needed
  std::vector<std::optional<Eigen::Matrix4d>> T_root_nodes_;
};

// Returns the transforms of a node's instances (EXT_mesh_gpu_instancing), or one identity if it has
// none. Fails where there are more than `most`.
[[nodiscard]] Result<std::vector<Eigen::Matrix4d>> instances_of(const std::string& name,
                                                                const tinygltf::Node& node,
                                                                const std::string& place,
                                                                Accessors& accessors,
                                                                std::size_t most);

}  // namespace penumbra::gltf
