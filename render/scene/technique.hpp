// Shadow techniques, and the kinds of light and of kernels that they use.
#pragma once

#include <cstddef>

#include "core/text/enum_names.hpp"

namespace penumbra {

enum class ShadowTechnique {
  none,
  simple,   // orthogonal projection onto the plane, one layer
  layered,  // layered penumbrae: umbra, middle, penumbra
  field,    // the same layers for one light size per part, as power-distance fields without kernels
  walls,    // simple, onto several planes: the table and walls around it
  hard,     // projected from the scene's lights, one layer for each
  volume,   // shadow volumes of the scene's lights on all surfaces, for a 3D cursor
};

// Properties of a technique that planning, drawing and the window depend on.
struct TechniqueTraits {
  // Casts umbra, middle and penumbra with the constants ShadowStyle::layered. Otherwise a
  // ShadowDraw is only the middle layer, cast along the plane's normal.
  bool has_penumbra = false;
  bool has_one_light_size = false;  // as with LightMode::fixed
  bool uses_kernels = false;
  bool uses_outlines = false;     // computes mask outlines on the CPU, for any mesh
  bool ignores_cut_outs = false;  // casts the shadows of whole faces
  bool uses_lights = false;       // casts from the scene's lights and can draw light rays
};
[[nodiscard]] constexpr TechniqueTraits traits_of(ShadowTechnique technique) {
  switch (technique) {
    case ShadowTechnique::none:
    case ShadowTechnique::simple:
    case ShadowTechnique::walls:
      return {};
    case ShadowTechnique::layered:
      return {.has_penumbra = true, .uses_kernels = true, .ignores_cut_outs = true};
    case ShadowTechnique::field:
      return {.has_penumbra = true, .has_one_light_size = true, .uses_outlines = true};
    case ShadowTechnique::hard:
      return {.uses_lights = true};
    case ShadowTechnique::volume:
      return {.ignores_cut_outs = true, .uses_lights = true};
  }
  return {};
}

// Maximum number of lights with hard shadows on one plane.
inline constexpr std::size_t kMaxHardLights = 7;

// Radius R_L of the light of layered shadows (docs/shadows.md#lights-of-one-size).
enum class LightMode {
  proportional,  // R_L follows the disc radius at each kernel: all umbrae vanish at one height
  fixed,         // one per part: where the part is thin, the umbra vanishes first (fixed_light.hpp)
};

enum class KernelSource {
  automatic,  // centre of the largest disc near the vertex, in the silhouette of its part
  smooth,     // mean over all discs near a vertex: fewer twisted faces
  per_axis,   // composed of three kernel sets, one per axis (Layered Penumbrae, section 5.3)
  centroid,   // COCL: one kernel for the whole object, the centroid of its footprint
};

inline constexpr auto kShadowTechniqueNames = std::to_array<EnumName<ShadowTechnique>>({
    {ShadowTechnique::none, "none"},
    {ShadowTechnique::simple, "simple"},
    {ShadowTechnique::layered, "layered"},
    {ShadowTechnique::field, "field"},
    {ShadowTechnique::walls, "walls"},
    {ShadowTechnique::hard, "hard"},
    {ShadowTechnique::volume, "volume"},
});
static_assert(kShadowTechniqueNames.size() ==
              static_cast<std::size_t>(ShadowTechnique::volume) + 1);

inline constexpr auto kLightModeNames = std::to_array<EnumName<LightMode>>(
    {{LightMode::proportional, "proportional"}, {LightMode::fixed, "fixed"}});

inline constexpr auto kKernelSourceNames = std::to_array<EnumName<KernelSource>>({
    {KernelSource::automatic, "auto"},
    {KernelSource::smooth, "smooth"},
    {KernelSource::per_axis, "per-axis"},
    {KernelSource::centroid, "cocl"},
});
static_assert(kKernelSourceNames.size() == static_cast<std::size_t>(KernelSource::centroid) + 1);

[[nodiscard]] constexpr std::string_view to_string(ShadowTechnique technique) {
  return name_of(kShadowTechniqueNames, technique);
}
[[nodiscard]] constexpr std::string_view to_string(KernelSource source) {
  return name_of(kKernelSourceNames, source);
}

}  // namespace penumbra
