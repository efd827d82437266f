// The places at which a glTF scene shows its meshes. Writing shadow kernels into the file needs
// them.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <vector>

#include "core/error.hpp"

namespace penumbra::gltf {

// A primitive at one place.
struct PrimitiveUse {
  std::size_t index = 0;            // among the mesh's primitives
  std::uint32_t source_vertex = 0;  // that Mesh::source_vertex has for its first vertex there
  // From the primitive's axes to the root's: one for all of its vertices, or one for each (skins).
  std::vector<Eigen::Matrix4d> T_root_vertex;
  bool is_hidden = false;  // its transforms leave nothing of its surface
};

// A mesh at one place.
struct MeshUse {
  int node = -1;  // -1: a file without nodes
  int mesh = -1;
  std::optional<Eigen::Matrix4d> T_node_instance;  // of one among a node's instances
  bool is_skinned = false;                         // directions are then in the root's axes
  std::vector<PrimitiveUse> primitives;            // those that have a surface
};

// In the order in which they are read into a model.
[[nodiscard]] Result<std::vector<MeshUse>> mesh_uses(const std::filesystem::path& file);

}  // namespace penumbra::gltf
