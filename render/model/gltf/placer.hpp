// Transforms primitives to the root frame and adds them to a model.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/meshes.hpp"
#include "render/model/gltf/notes.hpp"
#include "render/model/model.hpp"

namespace penumbra::gltf {

struct VertexPlacement {
  Eigen::Matrix4d T_root_mesh = Eigen::Matrix4d::Identity();      // if the mesh is rigid
  const std::vector<Eigen::Matrix4d>* joint_matrices = nullptr;   // if the mesh is skinned
  std::optional<Eigen::Matrix4d> T_node_instance = std::nullopt;  // if the node has instances
  std::uint32_t source_shift = 0;  // MeshReader::source_shift_of_next_use()
};

// One use of a primitive. The pointers refer to data of the readers.
struct PlacedPrimitive {
  const Primitive* primitive = nullptr;
  std::vector<double> morph_weights;  // one per target, or empty
  VertexPlacement placement;
  std::uint32_t node = 0;  // index into Model::nodes
  std::string json_path;   // JSON path of the node
};

// Returns false for a transform that flattens surfaces to lines or points.
[[nodiscard]] bool keeps_surfaces(const Eigen::Matrix4d& T);

// Collects primitives, then transforms them in double and adds them to a model.
class Placer {
 public:
  Placer(const ModelLimits& limits, Model& model, Notes& notes)
      : limits_(limits), model_(model), notes_(notes) {}

  [[nodiscard]] Result<void> collect(PlacedPrimitive placed);
  [[nodiscard]] Result<void> place_all();
  // Resolution of the file's coordinates after transformation; set by place_all().
  [[nodiscard]] double file_step() const { return file_step_; }

 private:
  void add(Mesh mesh);

  const ModelLimits& limits_;
  Model& model_;
  Notes& notes_;
  std::vector<PlacedPrimitive> collected_;
  std::unordered_map<int, std::size_t> mesh_of_material_;  // -> Model::meshes
  std::size_t vertices_ = 0;
  std::size_t triangles_ = 0;
  double file_step_ = 0.0;
};

}  // namespace penumbra::gltf
