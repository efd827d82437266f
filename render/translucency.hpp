// Modes of drawing translucent fragments: shadows, and objects that fade out.
#pragma once

#include <array>
#include <optional>
#include <string_view>

#include "render/gl/fragment_probe.hpp"

namespace penumbra {

enum class Translucency {
  automatic,      // the first of blend, retexture and mesh that works in the context
  blend,          // the blending hardware multiplies or mixes
  mesh,           // screen-door: pixels of an ordered pattern are black, the others unchanged
  retexture,      // fragments fetch the colour under them and write the result
  geometry_mesh,  // the mesh of Layered Penumbrae, as a baseline: black strips on the plane
};

struct TranslucencyName {
  Translucency way;
  std::string_view name;
};
inline constexpr std::array kTranslucencyNames = {
    TranslucencyName{Translucency::automatic, "auto"},
    TranslucencyName{Translucency::blend, "blend"},
    TranslucencyName{Translucency::mesh, "mesh"},
    TranslucencyName{Translucency::retexture, "retexture"},
    TranslucencyName{Translucency::geometry_mesh, "geometry-mesh"},
};
static_assert(kTranslucencyNames.size() ==
              static_cast<std::size_t>(Translucency::geometry_mesh) + 1);

[[nodiscard]] constexpr std::string_view to_string(Translucency mode) {
  for (const TranslucencyName& entry : kTranslucencyNames) {
    if (entry.way == mode) return entry.name;
  }
  return "auto";
}
[[nodiscard]] constexpr std::optional<Translucency> translucency_from_string(
    std::string_view name) {
  for (const TranslucencyName& entry : kTranslucencyNames) {
    if (entry.name == name) return entry.way;
  }
  return std::nullopt;
}

// Replaces `automatic` by a mode that works. Blending and fetching give the same image, blending at
// less cost; a mesh needs neither.
[[nodiscard]] constexpr Translucency choose_translucency(Translucency requested,
                                                         const FragmentAbilities& abilities) {
  if (requested != Translucency::automatic) return requested;
  if (abilities.blends) return Translucency::blend;
  return abilities.fetches ? Translucency::retexture : Translucency::mesh;
}

// Drawing of layered, field and simple shadows on a plane. Both methods show the same shadow.
enum class LayerDrawing {
  // A mask (docs/rendering.md#masks); directly if all shadows on a plane are simple, or with
  // multisampling if the casters have few faces.
  automatic,
  // The caster's faces, projected by the GPU, once for each layer; fields as textures.
  direct,
  // An image of all layers, made of the casters' silhouettes, of their faces if they are open or
  // cut
  // at a height, or of a field's outlines; directly if the orientation of faces is unknown.
  mask,
};

// Number of places in the screen-door's pattern; densities are multiples of one place.
inline constexpr int kDoorPlaces = 16;

}  // namespace penumbra
