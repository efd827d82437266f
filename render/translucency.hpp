// Modes of drawing translucent fragments: shadows, and objects that fade out.
#pragma once

#include "core/text/enum_names.hpp"
#include "render/gl/fragment_probe.hpp"

namespace penumbra {

enum class Translucency {
  automatic,      // the first of blend, retexture and mesh that works in the context
  blend,          // the blending hardware multiplies or mixes
  mesh,           // screen-door: pixels of an ordered pattern are black, the others unchanged
  retexture,      // fragments fetch the colour under them and write the result
  geometry_mesh,  // black strips on the plane, as in Layered Penumbrae; a baseline
};

inline constexpr auto kTranslucencyNames = std::to_array<EnumName<Translucency>>({
    {Translucency::automatic, "auto"},
    {Translucency::blend, "blend"},
    {Translucency::mesh, "mesh"},
    {Translucency::retexture, "retexture"},
    {Translucency::geometry_mesh, "geometry-mesh"},
});
static_assert(kTranslucencyNames.size() ==
              static_cast<std::size_t>(Translucency::geometry_mesh) + 1);
[[nodiscard]] constexpr std::string_view to_string(Translucency mode) {
  return name_of(kTranslucencyNames, mode);
}

// Replaces `automatic` by a mode that works in the context. `blend` and `retexture` give the same
// image, `blend` at a lower cost; `mesh` needs neither ability.
[[nodiscard]] constexpr Translucency choose_translucency(Translucency requested,
                                                         const FragmentAbilities& abilities) {
  if (requested != Translucency::automatic) return requested;
  if (abilities.blends) return Translucency::blend;
  return abilities.fetches ? Translucency::retexture : Translucency::mesh;
}

// Methods of drawing layered, field and simple shadows on a plane. They show the same shadow.
enum class LayerDrawing {
  // `mask`, or `direct` if all shadows on a plane are simple, or if the framebuffer is multisampled
  // and the casters have few faces (docs/rendering.md#masks).
  automatic,
  // The GPU projects the caster's faces once for each layer; fields are textures.
  direct,
  // One image of all layers: from silhouettes of closed casters, faces of open or clipped
  // casters, and outlines of fields. Falls back to `direct` if the orientation of faces is unknown.
  mask,
};
inline constexpr auto kLayerDrawingNames =
    std::to_array<EnumName<LayerDrawing>>({{LayerDrawing::automatic, "auto"},
                                           {LayerDrawing::direct, "direct"},
                                           {LayerDrawing::mask, "mask"}});

// Number of pixels of the 4 x 4 screen-door pattern.
inline constexpr int kScreenDoorPixels = 16;

}  // namespace penumbra
