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
  std::vector<std::string> warnings;  // parts of the model that it lacks
};

// Adds kernels to the .glb or .gltf `file`, whose other files are embedded. Kernels are written in
// each mesh's own axes and in the file's unit, `unit_m` [m]; the mesh's extras get the direction
// and the geometry's key. A mesh that several nodes or instances show is written once for each,
// with common data. Fails where a mesh is flattened.
[[nodiscard]] Result<KernelGlb> add_kernels_to_gltf(const std::filesystem::path& file,
                                                    const KernelFile& kernels, double unit_m = 1.0);

// Makes a .glb of a model that came in another format: shapes, normals, colours, materials, images
// and the names of nodes (an OBJ's objects and groups). The file is y up, in metres.
[[nodiscard]] Result<KernelGlb> make_glb_with_kernels(const Model& model,
                                                      const KernelFile& kernels);

}  // namespace penumbra
