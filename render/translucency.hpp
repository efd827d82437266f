// The ways in which what is translucent (shadows, and what fades out) reaches the picture.
#pragma once

#include <array>
#include <optional>
#include <string_view>

#include "render/gl/picture_abilities.hpp"

namespace penumbra {

enum class Translucency {
  automatic,      // the first of blend, retexture and mesh that works here
  blend,          // the picture is multiplied, or mixed, by the blending hardware
  mesh,           // screen-door: pixels are black or left alone, by an ordered pattern; no blending
  retexture,      // fragments fetch what lies under them and write it anew; no blending
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

[[nodiscard]] constexpr std::string_view to_string(Translucency way) {
  for (const TranslucencyName& entry : kTranslucencyNames) {
    if (entry.way == way) return entry.name;
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

// What is asked for is what is done; `automatic` is exact where it can be: blending and fetching
// give the same picture, the first at less cost; a mesh needs neither.
[[nodiscard]] constexpr Translucency choose_translucency(Translucency asked,
                                                         const PictureAbilities& abilities) {
  if (asked != Translucency::automatic) return asked;
  if (abilities.blends) return Translucency::blend;
  return abilities.fetches ? Translucency::retexture : Translucency::mesh;
}

// How layered, field and simple shadows reach a plane. Both ways show the same shadow.
enum class LayerDrawing {
  automatic,  // as a mask, which takes less whatever the number of faces (BENCHMARKS.md); but
              // directly where a pixel has several samples, which smooth edges too, and the casters
              // on a plane have few faces: the CPU then has next to nothing to do. Simple shadows
              // directly, where a plane has no others: they are what the others are compared with
  direct,     // the caster's faces, projected by the GPU, once for each layer; fields as textures
  mask,  // a picture of all layers, made of the casters' silhouettes, of their faces where they
         // are open or cut at a height, or of a field's outlines; directly where it can't be
         // told which way faces turn
};

// The screen-door's pattern has so many places: densities are multiples of one of them.
inline constexpr int kDoorPlaces = 16;

}  // namespace penumbra
