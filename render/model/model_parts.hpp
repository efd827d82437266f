// What the readers of model files share: reading beside the model, normals, checks of the result.
// Internal to render.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"
#include "render/model/model.hpp"

namespace penumbra {

// Nesting beyond this is refused: readers of JSON and walks over nodes recurse.
inline constexpr int kMaxModelDepth = 64;

// In the `extras` of a glTF mesh whose primitives have a _SHADOW_KERNEL attribute: the up direction
// that the kernels were made for, in the mesh's axes, and what they were made for (KernelStamp).
inline constexpr std::string_view kKernelUpKey = "shadow_kernel_up";
inline constexpr std::string_view kKernelGeometryKey = "shadow_kernel_geometry";
inline constexpr std::string_view kKernelGroupsKey = "shadow_kernel_groups";
inline constexpr std::size_t kMaxGroups = 1000;

// Path of a file that a model names. It never leaves the model's folder: of a name that does (see
// leaves_folder()), only the last part is taken and looked for beside the model. Backslashes are
// read as slashes, and a leading "file:" is skipped. Fails for a name without a last part. The file
// need not exist.
[[nodiscard]] Result<std::filesystem::path> beside_model(const std::filesystem::path& folder,
                                                         std::string_view name);
// Returns true for a name that points out of the model's folder: an absolute path, a drive letter,
// a web address, or a path with "..". Callers warn of it where they use beside_model()'s path.
[[nodiscard]] bool leaves_folder(std::string_view name);

// The greatest coordinate that a model file may have, in the file's unit. Positions are read in
// double and centred; ModelLimits limits the model's size.
inline constexpr double kMaxFileCoordinate_m = 1e12;

// Model::origin for a model with these bounds in the file: their middle where it is far away for
// their size, else zero. Readers subtract it in double, before a position becomes a float.
[[nodiscard]] Eigen::Vector3d model_origin(const Eigen::AlignedBox3d& bounds);

// Warns of a model far from the file's origin whose coordinates there are exact to `step` [m] only,
// where that is too coarse for its size.
[[nodiscard]] std::optional<std::string> warning_of_distance(const Eigen::AlignedBox3d& bounds,
                                                             double step, const std::string& name);

// sRGB-encoded 0..1 -> linear light.
[[nodiscard]] float linear_from_srgb(float encoded);

// Unit normals where `mesh.normals` is empty: the faces' normals, weighted by the corner's angle.
// A vertex without a face of any area gets +z.
void generate_normals(Mesh& mesh);

// Tangents by the layout of `texcoords` or, `second`, `texcoords_2`, weighted by the corner's
// angle. A vertex at which a layout meets its mirror image is split in two. Needs normals.
void generate_tangents(Mesh& mesh, bool second);

// Adds a mesh of the same material: a draw of its own for each of thousands of parts would take
// seconds. Attributes that only one of the two has are filled in with what their absence means.
void append_mesh(Mesh& mesh, const Mesh& more);

// Decodes a PNG or JPEG into the model, counted against the limit for all textures together.
// Gives the texture's index.
[[nodiscard]] Result<int> add_texture(Model& model, std::span<const std::uint8_t> bytes,
                                      const std::string& name, const ModelLimits& limits);

// Everything that drawing and shadows rely on: finite numbers within the limits, sizes that agree,
// indices in range, unit normals. Fills in the bounds.
[[nodiscard]] Result<void> check_model(Model& model, const std::string& name,
                                       const ModelLimits& limits);

// Both set `file_step` to the resolution of the file's coordinates where the model lies, in the
// file's unit.
[[nodiscard]] Result<Model> read_gltf(const std::filesystem::path& file,
                                      std::span<const std::uint8_t> bytes, bool binary,
                                      const ModelLimits& limits, double& file_step);
[[nodiscard]] Result<Model> read_obj(const std::filesystem::path& file,
                                     std::span<const std::uint8_t> bytes, const ModelLimits& limits,
                                     double& file_step);

}  // namespace penumbra
