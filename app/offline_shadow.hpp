// The shadow of one model on one plane, computed without a window: what `penumbra shadow` writes.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/model.hpp"
#include "render/scene.hpp"
#include "render/shadow/layer_polygons.hpp"
#include "render/shadow/plane_frame.hpp"
#include "render/shadow/shadow_kernels.hpp"
#include "render/shadow/twist.hpp"

namespace penumbra {

enum class OfflineTechnique {
  layered,  // scaled meshes, as the live renderer draws them
  field,    // power-distance layers: no kernels
  simple,   // orthogonal projection
};

struct ShadowRequest {
  std::filesystem::path model;
  UpAxis up_axis = UpAxis::by_format;
  OfflineTechnique technique = OfflineTechnique::layered;
  KernelSource kernels = KernelSource::automatic;
  std::optional<std::filesystem::path> kernel_file;  // in place of `kernels`
  LayeredConstants constants;
  Placement T_world_object;
  PlaneFrame plane;
};

struct NamedLayer {
  std::string name;
  LayerOutline outline;
};

struct OfflineShadow {
  LayeredConstants constants;
  std::vector<NamedLayer> layers;        // darkest first; simple: one, "shadow"
  LayerOutline footprint;                // the object itself, seen along the plane's normal
  std::vector<Eigen::Vector2d> kernels;  // in plane coordinates, one per vertex; empty without
  std::string kernel_source;
  double kernel_ms = 0.0;  // wall
  TwistReport twists;      // over the factors that occur
  std::vector<std::string> warnings;
};

[[nodiscard]] Result<OfflineShadow> compute_shadow(const ShadowRequest& request);

// Kernel files: {"kernels": [x0, y0, z0, x1, ...], "up": [0, 0, 1]}, object frame, one triple per
// vertex of the model file.
[[nodiscard]] Result<ShadowKernels> load_kernel_file(const std::filesystem::path& file,
                                                     const ShadowMesh& mesh);

}  // namespace penumbra
