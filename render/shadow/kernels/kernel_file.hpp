// Shadow kernels that are kept: in a JSON file beside a model, or in the model itself.
//
//   {"kernels": [x0,y0,z0, x1,...], "up": [0,0,1], "geometry": "...", "vertex_order": "...",
//    "groups": ["brick*"]}
//
// One triple per vertex of the model file, in its order; object frame, metres; for the direction
// `up`. Where a glTF file shows a mesh more than once (nodes, instances), each further time has its
// triples behind all others, in the order of the scene. "geometry" is a stamp (KernelStamp),
// "vertex_order" a hash of the vertices' order, "groups" the parts that share one light; each may
// be absent.
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
  std::string geometry, vertex_order;             // "" where the file has none
  std::vector<std::string> groups;                // of parts that are one (part_groups.hpp)
};

[[nodiscard]] Result<KernelFile> load_kernel_file(const std::filesystem::path& file);
[[nodiscard]] std::string kernel_file_json(const KernelFile& kernels);

// Gives a model the kernels of a file, in place of those it came with. Returns false, with a
// warning in the model, where the model has changed since they were made. Fails where the file is
// for another number of vertices.
[[nodiscard]] Result<bool> attach_kernels(Model& model, const KernelFile& kernels,
                                          const std::string& file);

// Gives them to every casting model of the scene with this number of vertices, or only to the model
// that the file names, where that is there. Adds warnings to the scene for kernels that do not fit
// the model or the groups of an object. Fails where no caster has that number of vertices.
[[nodiscard]] Result<void> attach_kernels_to_scene(Scene& scene, const KernelFile& kernels,
                                                   const std::string& file);

// Makes the file of a mesh's kernels. A vertex that no face uses gets the origin.
[[nodiscard]] KernelFile kernels_to_keep(const Model& model, const ShadowMesh& mesh,
                                         const ShadowKernels& kernels, KernelSource source,
                                         std::span<const std::string> groups = {});

// The kernels that came with the mesh.
[[nodiscard]] ShadowKernels stored_kernels_of(const ShadowMesh& mesh);
// Returns true if the mesh came with kernels that serve this direction or its opposite
// (docs/shadows.md#kernel-directions).
[[nodiscard]] bool has_stored_kernels_for(const ShadowMesh& mesh, const Eigen::Vector3d& up);
// Gives stored kernels, which have no radii, those of the discs made for `up`. Returns false where
// they have their own.
bool complete_radii(ShadowKernels& kernels, const ShadowMesh& mesh, const Eigen::Vector3d& up);

// The source of the kernels that came with the model; kernels for other tilts get the same.
[[nodiscard]] KernelSource stored_kernel_source(const Model& model);

// Returns true if a light of one size can use such kernels: those of the centroid have no radii.
[[nodiscard]] inline bool have_thickness(KernelSource source) {
  return source != KernelSource::centroid;
}

}  // namespace penumbra
