// A reduced mesh that casts layered shadows in place of its model
// (docs/shadows.md#reduced-casters).
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "render/model/model.hpp"
#include "render/model/shadow_mesh.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/kernels/shadow_kernels.hpp"

namespace penumbra {

struct ShadowProxy {
  ShadowMesh mesh;  // without from_source and stored_kernels; same parts as the full mesh
  std::vector<std::uint32_t> source_of;  // for each position: the nearest position of the full mesh
};

// Meshes with this number of faces or fewer are not reduced.
inline constexpr std::size_t kMinProxyFaces = 2000;
inline constexpr double kMinProxyAgreement = 0.98;       // minimum IoU of each layer
inline constexpr std::array kProxyHeights = {0.2, 0.6};  // compared: middle / umbra_height

// Reduces a mesh to half of its faces, or to a quarter if it has over 20,000. Returns nullopt for
// kMinProxyFaces or fewer, and if the mesh's borders prevent a reduction to three quarters.
[[nodiscard]] std::optional<ShadowProxy> simplified_caster(const ShadowMesh& full);

// Makes a proxy of the author's reduced model, in the same object frame.
[[nodiscard]] ShadowProxy proxy_from_model(const ShadowMesh& full, const Model& model);
// Returns the full mesh's kernels for the positions of the proxy.
[[nodiscard]] ShadowKernels carried_kernels(const ShadowProxy& proxy, const ShadowKernels& full);

struct ProxyAgreement {
  // [index into kProxyHeights][index into kShadowLayers]; 1 if both layers are empty.
  std::array<std::array<double, 3>, 2> iou{};
  [[nodiscard]] double min_iou() const;
  [[nodiscard]] bool is_sufficient() const { return min_iou() >= kMinProxyAgreement; }
};

// The light and the object's scale for which compare_with_proxy() compares layers.
struct ProxyUse {
  LayeredConstants constants;
  LightMode light_mode = LightMode::proportional;
  double scale = 1.0;
};

// Compares the layers on a plane normal to kernels.up. `kernels` belong to the full mesh. Only a
// fixed light needs `parts` (from part_discs()) and the radii of the kernels. Unless `thorough`,
// stops at the first layer that disagrees; the remaining IoUs are then 0.
[[nodiscard]] ProxyAgreement compare_with_proxy(const ShadowMesh& full,
                                                const ShadowKernels& kernels,
                                                std::span<const PartDisc> parts,
                                                const ShadowProxy& proxy, const ProxyUse& use,
                                                bool thorough);

}  // namespace penumbra
