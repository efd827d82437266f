// Shadow kernels inside a binary glTF file, as the vertex attribute _SHADOW_KERNEL.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/shadow/kernels/kernel_file.hpp"

namespace penumbra {

struct KernelGlb {
  std::vector<std::uint8_t> bytes;
  std::vector<std::string> warnings;  // what of the model is not in it
};

// The .glb or .gltf `file` with the kernels added and everything else as it was; what lies beside
// it is embedded. Kernels are written in each mesh's own axes and in the file's unit, `unit_m` [m],
// as its positions are; the mesh's extras get the direction and the geometry's key. A mesh that
// several nodes show, or several instances, is written once for each, with common data: its copies
// have kernels of their own. Fails where a mesh is flattened.
[[nodiscard]] Result<KernelGlb> add_kernels_to_gltf(const std::filesystem::path& file,
                                                    const KernelFile& kernels, double unit_m = 1.0);

// A new .glb of a model that came in another format: shapes, normals, colours, materials, pictures
// and the names of nodes (an OBJ's objects and groups). The glTF file is y up, in metres: (x, y, z)
// is written as (x, z, -y).
[[nodiscard]] Result<KernelGlb> make_glb_with_kernels(const Model& model,
                                                      const KernelFile& kernels);

}  // namespace penumbra
