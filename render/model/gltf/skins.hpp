// Skins: vertices that follow joints (glTF 2.0, 3.7.3.3).
#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/accessors.hpp"
#include "render/model/gltf/meshes.hpp"
#include "render/model/gltf/nodes.hpp"

namespace penumbra::gltf {

class Skins {
 public:
  Skins(std::string name, const tinygltf::Model& gltf, Accessors& accessors, Nodes& nodes)
      : name_(std::move(name)), gltf_(gltf), accessors_(accessors), nodes_(nodes) {}

  // Per joint of a skin: T_root_joint times its inverse bind matrix, which takes a vertex of the
  // mesh to its place in the root frame.
  [[nodiscard]] Result<const std::vector<Eigen::Matrix4d>*> joint_matrices(int skin);

 private:
  [[nodiscard]] Result<std::vector<Eigen::Matrix4d>> inverse_bind_matrices(
      const tinygltf::Skin& skin, const std::string& place) const;

  std::string name_;
  const tinygltf::Model& gltf_;
  Accessors& accessors_;
  Nodes& nodes_;
  std::map<int, std::vector<Eigen::Matrix4d>> known_;
};

// Fails where a vertex follows a joint that the skin does not have.
[[nodiscard]] Result<void> check_joints(const std::string& name, const Primitive& primitive,
                                        std::size_t joint_count);

// The weighted sum of the matrices of a vertex's joints.
[[nodiscard]] Eigen::Matrix4d blended(const SkinWeights& skin, std::size_t vertex,
                                      const std::vector<Eigen::Matrix4d>& joint_matrices);

}  // namespace penumbra::gltf
