// The region of a mask that one caster covers, and its rasterisation into a MaskRaster.
#pragma once

#include "render/passes/layers/shadow_geometry.hpp"
#include "render/shadow/masks/silhouette_mask.hpp"

namespace penumbra {

// All inputs that determine the cells covered by a part.
struct MaskShape {
  CachedCaster* caster = nullptr;
  double pose_s = 0.0;  // see PosedModel
  KernelKey kernels;
  bool reduced = false;
  OwnFrame own;
  LayeredConstants constants;
  LightMode light_mode = LightMode::proportional;
  LayerSources layers{};  // masked, masked_faces, masked_outline or nothing
  friend bool operator==(const MaskShape&, const MaskShape&) = default;
};

struct MaskPart : MaskShape {
  std::shared_ptr<const FieldOutlines> outlines;
  glm::vec3 light{0.0F};  // mask value of each layer (light left)

  // `prepared` must be made for a mask.
  static MaskPart of(const ShadowDraw& draw, CachedCaster& caster, const PreparedShadow& prepared,
                     const glm::vec3& light);

  [[nodiscard]] bool covers_nothing() const { return layers == LayerSources{}; }
  [[nodiscard]] bool covers_same_as(const MaskShape& other) const { return *this == other; }
  [[nodiscard]] bool same_as(const MaskPart& other) const {
    return light == other.light && covers_same_as(other);
  }

  using Faces = std::array<std::vector<PlanePoint>, 3>;
  // Returns the triangles of layers masked face by face, in the own frame.
  [[nodiscard]] Faces face_images(RenderWork& work) const;
  // Projects the part onto cells of the size `cell` [m].
  void project(const Faces& faces, double cell, MaskCaster& projected, RenderWork& work) const;
  // Adds the projected part to a raster with cells of the same size as in project().
  void cover(MaskCaster& projected, MaskRaster& raster) const;
};

}  // namespace penumbra
