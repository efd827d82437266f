// Functions shared by the readers of model files: paths, normals, checks. Internal to render.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"
#include "core/image/image_file.hpp"
#include "render/model/model.hpp"

namespace penumbra {

// Maximum depth of JSON and of node trees.
inline constexpr int kMaxModelDepth = 64;

// Keys in the `extras` of a glTF mesh whose primitives have a _SHADOW_KERNEL attribute: the
// kernels' up direction in the mesh's axes, their KernelStamp and their groups of parts.
inline constexpr std::string_view kKernelUpKey = "shadow_kernel_up";
inline constexpr std::string_view kKernelGeometryKey = "shadow_kernel_geometry";
inline constexpr std::string_view kKernelGroupsKey = "shadow_kernel_groups";
inline constexpr std::size_t kMaxGroups = 1000;

// Returns the path, in the model's folder, of a file that a model refers to. If the name
// leaves_folder(), only its last component is used. Backslashes count as slashes; a leading "file:"
// is removed. Fails if the name has no last component. The file need not exist.
[[nodiscard]] Result<std::filesystem::path> model_resource_path(const std::filesystem::path& folder,
                                                                std::string_view name);
// Returns true for a name that leads out of the model's folder: an absolute path, a drive letter, a
// web address, or a path with "..". Callers of model_resource_path() then add a warning.
[[nodiscard]] bool leaves_folder(std::string_view name);

// Maximum absolute coordinate in a model file, in the file's unit. See also ModelLimits.
inline constexpr double kMaxFileCoordinate = 1e12;

// Returns Model::origin for the bounds in the file: their centre if it is far away relative to
// their size, else zero. Readers subtract it in double.
[[nodiscard]] Eigen::Vector3d model_origin(const Eigen::AlignedBox3d& bounds);

// Returns a warning if the resolution `step` [m] of the file's coordinates is too coarse.
[[nodiscard]] std::optional<std::string> warning_of_distance(const Eigen::AlignedBox3d& bounds,
                                                             double step, const std::string& name);

// Decodes sRGB, 0 to 1.
[[nodiscard]] float linear_from_srgb(float encoded);

// Computes unit normals: the mean of the faces' normals, weighted by the corners' angles. A vertex
// without a face of non-zero area gets +z.
void generate_normals(Mesh& mesh);

// Computes tangents for `texcoords`, or `texcoords_2` if `second`, weighted by the corners' angles.
// Splits vertices shared by mirrored and unmirrored texture layouts. Requires normals.
void generate_tangents(Mesh& mesh, bool second);

// Merges a mesh of the same material, because thousands of draw calls would be slow. Attributes
// that one mesh lacks get default values; stored kernels are kept only if both meshes have them.
void append_mesh(Mesh& mesh, const Mesh& more);

// Adds an image to the model, within the limit for all textures. Returns its index. `encoded`: see
// Texture.
[[nodiscard]] Result<int> add_texture(Model& model, RgbaImage image, const std::string& name,
                                      const ModelLimits& limits,
                                      std::vector<std::uint8_t> encoded = {});

// Checks preconditions of drawing and shadows: finite numbers within the limits, consistent sizes,
// indices in range. Normalises normals and sets the bounds, which are zero without triangles.
[[nodiscard]] Result<void> check_model(Model& model, const std::string& name,
                                       const ModelLimits& limits);

// The readers use the file's axes and unit. `file_step`: returns the resolution of coordinates.
[[nodiscard]] Result<Model> read_gltf(const std::filesystem::path& file,
                                      std::span<const std::uint8_t> bytes, bool binary,
                                      const ModelLimits& limits, double& file_step);
// A glTF file with one of its animations, or with all of them, in memory.
class GltfShapes {
 public:
  // `animation`: see ModelPose.
  [[nodiscard]] static Result<GltfShapes> open(const std::filesystem::path& file,
                                               std::vector<std::uint8_t> bytes, bool binary,
                                               const ModelLimits& limits,
                                               const std::string& animation);
  GltfShapes(GltfShapes&&) noexcept;
  ~GltfShapes();

  // Returns the model at a time, without stored kernels. It may have no triangles.
  [[nodiscard]] Result<Model> at(double time_s, double& file_step);
  [[nodiscard]] double end_s() const;  // time of the last key

 private:
  struct Impl;
  explicit GltfShapes(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

[[nodiscard]] Result<Model> read_obj(const std::filesystem::path& file,
                                     std::span<const std::uint8_t> bytes, const ModelLimits& limits,
                                     double& file_step);

}  // namespace penumbra
