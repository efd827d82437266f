// Transforms primitives to the root frame and adds them to a model.
#pragma once

#include <Eigen/Core>
#include <string>
#include <unordered_map>
#include <vector>

#include "core/error.hpp"
#include "render/gltf/meshes.hpp"
#include "render/gltf/notes.hpp"
#include "render/model.hpp"

namespace penumbra::gltf {

// The transform of the vertices of a mesh.
struct VertexPlacement {
  Eigen::Matrix4d T_root_mesh = Eigen::Matrix4d::Identity();     // of a rigid mesh
  const std::vector<Eigen::Matrix4d>* joint_matrices = nullptr;  // of a skinned one
};

// Adds `weights[t]` times target t to the vertices of a mesh.
void apply_morph_targets(Mesh& mesh, const std::vector<MorphTarget>& targets,
                         const std::vector<double>& weights);

class Placer {
 public:
  Placer(std::string name, const ModelLimits& limits, Model& model, Notes& notes)
      : name_(std::move(name)), limits_(limits), model_(model), notes_(notes) {}

  // `weights`: of the morph targets. `node`: index into Model::nodes. `what`: place of the node.
  [[nodiscard]] Result<void> place(const Primitive& primitive, const std::vector<double>& weights,
                                   const VertexPlacement& placement, std::uint32_t node,
                                   const std::string& what);

 private:
  [[nodiscard]] Result<void> count(const Mesh& mesh, const std::string& what);
  void add(Mesh mesh);

  std::string name_;
  const ModelLimits& limits_;
  Model& model_;
  Notes& notes_;
  std::unordered_map<int, std::size_t> mesh_of_material_;  // -> Model::meshes
  std::size_t placed_vertices_ = 0;
  std::size_t placed_triangles_ = 0;
};

}  // namespace penumbra::gltf
