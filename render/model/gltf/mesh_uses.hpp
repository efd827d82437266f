// Lists the uses of meshes in a glTF scene, for writing shadow kernels into the file.
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
  std::uint32_t source_vertex = 0;  // Mesh::source_vertex of its first vertex in this use
  // One transform for all vertices, or one per vertex (skins).
  std::vector<Eigen::Matrix4d> T_root_vertex;
  bool is_hidden = false;  // the transforms flatten its surface
};

struct MeshUse {
  int node = -1;  // -1: a file without nodes
  int mesh = -1;
  std::optional<Eigen::Matrix4d> T_node_instance;  // if the node has instances
  bool is_skinned = false;  // true: the direction stored with the kernels is in the root frame
  std::vector<PrimitiveUse> primitives;  // primitives with a surface
};

// Returns all uses of meshes, in the order in which load_model() reads them.
[[nodiscard]] Result<std::vector<MeshUse>> mesh_uses(const std::filesystem::path& file);

}  // namespace penumbra::gltf
