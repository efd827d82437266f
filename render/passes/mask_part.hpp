// What a mask shows of one caster's shadow, and how it gets into a MaskPicture.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "render/passes/caster_cache.hpp"
#include "render/passes/shadow_geometry.hpp"
#include "render/shadow/masks/silhouette_mask.hpp"

namespace penumbra {

struct MaskPart {
  CachedCaster* caster = nullptr;
  KernelKey kernels;
  bool reduced = false;
  OwnFrame own;
  LayeredConstants constants;
  LightMode light_mode = LightMode::proportional;
  std::array<bool, 3> layers{};  // by silhouettes
  std::array<bool, 3> faces{};   // face by face
  std::array<bool, 3> sides{};   // by a field's outlines
  std::shared_ptr<const FieldOutlines> outlines;
  glm::vec3 light{0.0F};  // what each layer leaves, as the mask stores it

  // `prepared` was made for a mask.
  static MaskPart of(const ShadowDraw& draw, CachedCaster& caster, const PreparedShadow& prepared,
                     const glm::vec3& light);

  [[nodiscard]] bool covers_nothing() const;
  [[nodiscard]] bool covers_same_as(const MaskPart& other) const;
  [[nodiscard]] bool same_as(const MaskPart& other) const {
    return light == other.light && covers_same_as(other);
  }

  using Faces = std::array<std::vector<PlanePoint>, 3>;
  // The triangles of the layers that are covered face by face; own frame.
  [[nodiscard]] Faces face_images(RenderWork& work) const;
  // Projects the part onto cells of this size [m].
  void project(const Faces& faces, double cell, MaskCaster& projected, RenderWork& work) const;
  // Adds what was projected to a picture of cells of that size.
  void cover(MaskCaster& projected, MaskPicture& picture) const;
};

}  // namespace penumbra
