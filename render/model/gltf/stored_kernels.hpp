// Metadata of `_SHADOW_KERNEL` attributes, in the `extras` of meshes.
#pragma once

#include <tiny_gltf.h>

#include <Eigen/Core>
#include <string>

#include "render/model/model.hpp"

namespace penumbra::gltf {

class StoredKernels {
 public:
  StoredKernels(std::string name, Model& model) : name_(std::move(name)), model_(model) {}

  // Adds the `extras` of a mesh to the model. The direction is in the mesh's own axes, as
  // the attribute is; `linear` turns them into the root's.
  void take(const tinygltf::Value& extras, const Eigen::Matrix3d& linear, const std::string& what);
  // Drops the kernels where their direction is unknown or the meshes disagree about it.
  void finish();

 private:
  void take_groups(const tinygltf::Value& extras, const std::string& what);

  std::string name_;
  Model& model_;
  bool disagree_ = false;
};

}  // namespace penumbra::gltf
