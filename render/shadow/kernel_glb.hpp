// Shadow kernels inside a binary glTF file, as the vertex attribute _SHADOW_KERNEL.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/error.hpp"
#include "render/shadow/kernel_file.hpp"

namespace penumbra {

// A .glb with the kernels added and everything else as it was. Kernels are written in each mesh's
// own axes, as its positions are; the mesh's extras get the direction and the geometry's key. Fails
// where a mesh hangs in the scene more than once: its vertices would need several kernels.
[[nodiscard]] Result<std::vector<std::uint8_t>> add_kernels_to_glb(
    std::span<const std::uint8_t> glb, const KernelFile& kernels, const std::string& name);

// A new .glb of a model that came in another format: shapes, normals, colours, materials and the
// names of nodes (an OBJ's objects and groups), but no pictures. The glTF file is y up: (x, y, z)
// is written as (x, z, -y).
[[nodiscard]] Result<std::vector<std::uint8_t>> make_glb_with_kernels(const Model& model,
                                                                      const KernelFile& kernels);

}  // namespace penumbra
