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
  std::vector<std::string> warnings;  // about content of the model that the .glb lacks
};

// Adds kernels to the .glb or .gltf `file` and embeds its external files. Kernels are written in
// each mesh's axes and in the file's unit, `unit_m` [m]. The mesh's extras record the direction
// and the geometry's key. A mesh used by several nodes or instances is written once per use; the
// copies share the other attributes. Fails if a transform flattens a mesh.
[[nodiscard]] Result<KernelGlb> add_kernels_to_gltf(const std::filesystem::path& file,
                                                    const KernelFile& kernels, double unit_m = 1.0);

// Converts a model of another format to a .glb: shapes, normals, colours, materials, images and
// node names (an OBJ's objects and groups). The file is y up, in metres.
[[nodiscard]] Result<KernelGlb> make_glb_with_kernels(const Model& model,
                                                      const KernelFile& kernels);

}  // namespace penumbra
