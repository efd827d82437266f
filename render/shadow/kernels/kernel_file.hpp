// Shadow kernels that are kept: in a JSON file beside a model, or in the model itself.
//
//   {"kernels": [x0,y0,z0, x1,...], "up": [0,0,1], "geometry": "...", "vertex_order": "...",
//    "groups": ["brick*"]}
//
// One triple per vertex of the model file, in its order; object frame, metres; for the direction
// `up`. Where a glTF file shows a mesh more than once (several nodes, instances), the vertices of
// each further time have triples of their own behind all others, in the order in which the scene
// shows them. "geometry" says what they were made for (KernelStamp), "vertex_order" is a hash
// of the order of the file's vertices, "groups" names the parts that share one light; each may be
// absent.
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
  // One per vertex of the model file, object frame [m], relative to `origin` (Model::origin). The
  // JSON file has the sums.
  std::vector<glm::vec3> kernels;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d up = Eigen::Vector3d::UnitZ();  // unit
  std::string geometry;                           // "" where the file does not say
  std::string vertex_order;                       // the same
  std::vector<std::string> groups;                // of parts that are one (part_groups.hpp)
};

[[nodiscard]] Result<KernelFile> load_kernel_file(const std::filesystem::path& file);
[[nodiscard]] std::string kernel_file_json(const KernelFile& kernels);

// Gives a model the kernels of a file, in place of those it came with. True where they were taken;
// false, with a warning in the model, where the model has changed since they were made. Fails where
// the file is for another number of vertices.
[[nodiscard]] Result<bool> attach_kernels(Model& model, const KernelFile& kernels,
                                          const std::string& file);

// Gives them to every casting model of the scene that has as many vertices (of those, where the
// file says which model it is for and that one is there, to it alone). What was not taken is in the
// scene's warnings, and so is what does not fit the groups of an object. Fails where no caster has
// that number of vertices.
[[nodiscard]] Result<void> give_kernels(Scene& scene, const KernelFile& kernels,
                                        const std::string& file);

// What to keep: a vertex of the file that no face uses gets the origin.
[[nodiscard]] KernelFile kernels_to_keep(const Model& model, const ShadowMesh& mesh,
                                         const ShadowKernels& kernels, KernelSource source,
                                         std::span<const std::string> groups = {});

// The kernels that came with the mesh.
[[nodiscard]] ShadowKernels stored_kernels_of(const ShadowMesh& mesh);
// Up to here from their own direction kernels still serve (docs/shadows.md#kernel-directions).
inline constexpr double kKernelTiltRad = 2.0 * 3.14159265358979323846 / 180.0;
// Whether the mesh came with kernels that serve this direction. k(d) = k(-d).
[[nodiscard]] bool has_stored_kernels_for(const ShadowMesh& mesh, const Eigen::Vector3d& up);
// Kernels that were kept have no radii: gives them those of the discs made for `up`. False where
// they have their own.
bool complete_radii(ShadowKernels& kernels, const ShadowMesh& mesh, const Eigen::Vector3d& up);

// How the kernels that came with the model were made, and are to be made for other tilts.
[[nodiscard]] KernelSource stored_kernel_source(const Model& model);

// Whether a light of one size can use such kernels: those of the centroid have no thickness to
// compare with it.
[[nodiscard]] inline bool have_thickness(KernelSource source) {
  return source != KernelSource::centroid;
}

}  // namespace penumbra
