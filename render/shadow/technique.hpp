// The one list of shadow techniques.
#pragma once

#include <array>
#include <optional>
#include <string_view>

namespace penumbra {

enum class ShadowTechnique {
  none,
  simple,   // orthogonal projection onto the plane, one layer
  layered,  // layered penumbrae: umbra, middle, penumbra
};

struct ShadowTechniqueName {
  ShadowTechnique technique;
  std::string_view name;
};
inline constexpr std::array kShadowTechniqueNames = {
    ShadowTechniqueName{ShadowTechnique::none, "none"},
    ShadowTechniqueName{ShadowTechnique::simple, "simple"},
    ShadowTechniqueName{ShadowTechnique::layered, "layered"},
};

[[nodiscard]] constexpr std::string_view to_string(ShadowTechnique technique) {
  for (const ShadowTechniqueName& entry : kShadowTechniqueNames) {
    if (entry.technique == technique) return entry.name;
  }
  return "none";
}
[[nodiscard]] constexpr std::optional<ShadowTechnique> shadow_technique_from_string(
    std::string_view name) {
  for (const ShadowTechniqueName& entry : kShadowTechniqueNames) {
    if (entry.name == name) return entry.technique;
  }
  return std::nullopt;
}

// Where shadow kernels come from (shadows.md: COCL is the layered technique with one kernel for the
// whole object).
enum class KernelSource {
  automatic,  // generated from the silhouette, per connected part
  centroid,   // COCL: one kernel, the centre of the footprint
};

}  // namespace penumbra
