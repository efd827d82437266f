// The places at which a glTF scene shows its meshes, for writing shadow kernels into the file.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <vector>

#include "core/error.hpp"

namespace penumbra::gltf {

struct PrimitiveUse {
  std::size_t index = 0;            // among the mesh's primitives
  std::uint32_t source_vertex = 0;  // Mesh::source_vertex of its first vertex there
  // One transform for all of its vertices, or one for each (skins).
  std::vector<Eigen::Matrix4d> T_root_vertex;
  bool is_hidden = false;  // its transforms flatten the surface
};

struct MeshUse {
  int node = -1;  // -1: a file without nodes
  int mesh = -1;
  std::optional<Eigen::Matrix4d> T_node_instance;  // of one among a node's instances
  bool is_skinned = false;                         // directions are then in the root's axes
  std::vector<PrimitiveUse> primitives;            // those that have a surface
};

// Returns them in the order in which they are read into a model.
[[nodiscard]] Result<std::vector<MeshUse>> mesh_uses(const std::filesystem::path& file);

}  // namespace penumbra::gltf
