// Stored shadow kernels: in a JSON file, or in the model file itself.
//
//   {"kernels": [x0,y0,z0, x1,...], "up": [0,0,1], "geometry": "...", "vertex_order": "...",
//    "groups": ["brick*"]}
//
// "kernels": one triple per vertex, in the order of the model file; object frame [m]; made for the
// direction "up". If nodes or instances of a glTF file share a mesh, the triples for its first use
// are at the mesh's position in the file's order; the triples for further uses follow at the end,
// in the scene's order. Optional: "geometry", a stamp (KernelStamp); "vertex_order", a hash of the
// vertices' order; "groups", parts that share one light.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <glm/vec3.hpp>
#include <span>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/kernels/shadow_kernels.hpp"

namespace penumbra {

struct KernelFile {
  // One per vertex of the model file, object frame [m], relative to `origin` (Model::origin).
  std::vector<glm::vec3> kernels;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();  // unit
  std::string geometry, vertex_order;             // "" if absent
  std::vector<std::string> groups;                // parts that share one light (part_groups.hpp)
};

[[nodiscard]] Result<KernelFile> load_kernel_file(const std::filesystem::path& file);
[[nodiscard]] std::string kernel_file_json(const KernelFile& kernels);

// Replaces a model's stored kernels by those of a file. Returns false and adds a warning to the
// model if the model has changed since the kernels were made. Fails if the number of vertices
// differs.
[[nodiscard]] Result<bool> attach_kernels(Model& model, const KernelFile& kernels,
                                          const std::string& file);

// Attaches the kernels to every caster with the same number of vertices; if casters among them
// match the file's geometry and vertex order, only to these. Adds a warning to the scene if kernels
// do not fit a model or an object's groups. Fails if no caster has that number of vertices.
[[nodiscard]] Result<void> attach_kernels_to_scene(Scene& scene, const KernelFile& kernels,
                                                   const std::string& file);

// Makes the contents of a kernel file. The kernel of a vertex that no face uses is (0, 0, 0).
[[nodiscard]] KernelFile make_kernel_file(const Model& model, const ShadowMesh& mesh,
                                          const ShadowKernels& kernels, KernelSource source,
                                          std::span<const std::string> groups = {});

// Returns the kernels stored with the mesh.
[[nodiscard]] ShadowKernels stored_kernels_of(const ShadowMesh& mesh);
// Returns true if the mesh has stored kernels for this direction or its opposite
// (docs/shadows.md#kernel-directions).
[[nodiscard]] bool has_stored_kernels_for(const ShadowMesh& mesh, const Eigen::Vector3d& up);
// Computes the disc radii for `up` if they are missing, as in stored kernels. Returns true if they
// were missing.
bool add_missing_radii(ShadowKernels& kernels, const ShadowMesh& mesh, const Eigen::Vector3d& up);

// Returns the source of the model's stored kernels. Kernels for other tilts use the same source.
[[nodiscard]] KernelSource stored_kernel_source(const Model& model);

// Returns true if kernels of this source have radii, which LightMode::fixed needs.
[[nodiscard]] inline bool have_radii(KernelSource source) {
  return source != KernelSource::centroid;
}

}  // namespace penumbra
