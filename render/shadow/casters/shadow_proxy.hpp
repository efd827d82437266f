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
  ShadowMesh mesh;  // from_source and stored_kernels are empty; parts are those of the full mesh
  std::vector<std::uint32_t> source_of;  // per position the nearest position of the full mesh
};

// Meshes of up to this number of faces are not reduced.
inline constexpr std::size_t kLeastProxyFaces = 2000;
inline constexpr double kLeastProxyAgreement = 0.98;
inline constexpr std::array kProxyHeights = {0.2, 0.6};  // of the object's middle, in h_u

// Reduces a mesh to half of its faces, a quarter above 20,000. Nothing for kLeastProxyFaces or
// fewer, and where borders leave more than three quarters of the faces.
[[nodiscard]] std::optional<ShadowProxy> simplified_caster(const ShadowMesh& full);

// Makes a proxy of the author's reduced model, in the same object frame.
[[nodiscard]] ShadowProxy proxy_from_model(const ShadowMesh& full, const Model& model);

[[nodiscard]] ShadowKernels carried_kernels(const ShadowProxy& proxy, const ShadowKernels& full);

struct ProxyAgreement {
  // Per height of kProxyHeights, per layer as in kShadowLayers; 1 where both are empty.
  std::array<std::array<double, 3>, 2> iou{};
  [[nodiscard]] double least() const;
  [[nodiscard]] bool kept() const { return least() >= kLeastProxyAgreement; }
};

// The light, and the object's scale in it.
struct ProxyUse {
  LayeredConstants constants;
  LightMode light_mode = LightMode::proportional;
  double scale = 1.0;
};

// Compares the layers for the kernels' up direction. `kernels` are those of the full mesh; `parts`
// (part_discs) and the radii of the kernels are needed for a fixed light only. Without `thorough`
// it stops at the first layer that disagrees and leaves the rest at 0.
[[nodiscard]] ProxyAgreement compare_with_proxy(const ShadowMesh& full,
                                                const ShadowKernels& kernels,
                                                std::span<const PartDisc> parts,
                                                const ShadowProxy& proxy, const ProxyUse& use,
                                                bool thorough);

}  // namespace penumbra
