// A layer of a shadow as a volume (rendering.md 5): the caster's imaginary mesh, each vertex at its
// own height and in its image's place, swept straight down onto the plane and through what stands
// on it. Nested for the three layers, they carry the outlines that the shadow has on the plane over
// all that lies between: what they darken tells the height over the plane, not over what it is
// seen on.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "render/scene/plane_frame.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"
#include "render/shadow/shadow_mesh.hpp"
#include "render/shadow/volumes/shadow_volume.hpp"

namespace penumbra {

// A caster over a plane: what the layers' formulas take.
struct CasterOverPlane {
  // In (u, v) and height above the plane, and its kernel [m]: one for each of the mesh's positions.
  std::vector<CasterVertex> vertices;
  const ShadowMesh* mesh = nullptr;
  LayeredConstants constants;
};

class LayerVolumeCaster {
 public:
  // The mesh must outlive it.
  explicit LayerVolumeCaster(const ShadowMesh& mesh);

  // `caster` is of this mesh. Table frame [m]; `plane` is given in that. It reaches under the
  // plane; empty where nothing of the caster is in the layer's heights, or where its points are not
  // finite. Cut at the heights of shadows.md 2.2.
  [[nodiscard]] ShadowVolume volume(const CasterOverPlane& caster, ShadowLayer layer,
                                    const PlaneFrame& plane) const;

 private:
  const ShadowMesh* mesh_;
  VolumeCaster whole_;
  // Faces by their part, for casters that are cut.
  std::vector<std::vector<std::uint32_t>> faces_of_parts_;
};

}  // namespace penumbra
