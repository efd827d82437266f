// The geometry of a shadow's layers on one plane, made on the CPU and kept while its caster only
// slides or turns on the plane.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "render/passes/layers/caster_cache.hpp"
#include "render/passes/layers/field_quad.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"
#include "render/shadow/masks/silhouette_mask.hpp"

namespace penumbra {

// Frames without use after which the geometry of a receiver's shadows is freed.
inline constexpr std::uint64_t kFramesKept = 150;

enum class LayerSource {
  nothing,
  whole,           // the mesh, projected by the vertex shader
  placed,          // vertices projected on the CPU, with those added for the lens
  clipped,         // faces cut at a height, or split, on the CPU
  field,           // a field's texture
  masked,          // in the plane's mask, by silhouettes
  masked_faces,    // in the mask, face by face: open or cut meshes
  masked_outline,  // in the mask, by a field's outline
};
using LayerSources = std::array<LayerSource, 3>;

// Outlines of each layer of a field, own frame.
using FieldOutlines = std::array<std::vector<OutlineSide>, 3>;

struct LayerGeometry {
  LayerSource source = LayerSource::nothing;
  int first = 0;  // vertices in the clipped buffer
  int count = 0;
};

// The inputs of a shadow's geometry, beside the own frame.
struct ShadowKey {
  ShadowTechnique technique = ShadowTechnique::layered;
  LightMode light_mode = LightMode::proportional;
  LayeredConstants constants;    // default for simple shadows
  std::array<bool, 3> layers{};  // wanted; none for fields, which have all
  bool reduced = false;          // the proxy casts
  bool masked = false;           // in the plane's mask
  KernelKey kernels;
  friend bool operator==(const ShadowKey&, const ShadowKey&) = default;
};

struct PreparedShadow {
  bool valid = false;
  OwnFrame own;
  ShadowKey key;
  std::array<bool, 3> wanted{};
  std::array<LayerGeometry, 3> layers;
  std::size_t surface = 0;  // index of the caster's range that is fine enough in this frame
  // The largest ratio of a long edge's image to the edge, in placed layers.
  double magnification = 1.0;
  std::array<VertexArray, 3> placed_layouts;
  GlBuffer placed{BufferUse::vertices};
  GlMesh clipped{3, 2};  // (u, v, h) and (ku, kv)
  FieldTexture field;
  std::shared_ptr<const FieldOutlines> outlines;  // of a field in a mask; else null
  std::uint64_t last_used = 0;                    // frame, for shadows on receivers

  void clear() {
    layers = {};
    valid = false;
  }
};

// A shadow of the plan with its caster.
struct ShadowItem {
  CachedCaster* caster = nullptr;
  PreparedShadow* prepared = nullptr;
  int node = 0, object = 0, plane = 0;
  PlaneFrame plane_frame;
};

// Bounds of a shadow's layers at all heights above its plane from one upwards.
struct ShadowReach {
  // (u, v) on the plane [m]; empty: nothing casts there.
  Eigen::AlignedBox2d box;
  double low = 0.0;   // lowest height of the casting faces [m]
  double rate = 0.0;  // greatest shift of outlines per receiving height [m / m]
};

// Returns each layer's factor on the encoded value of the video.
[[nodiscard]] glm::vec3 layer_light(const ShadowDraw& draw);

// A simple shadow is the middle layer of a light at the zenith.
[[nodiscard]] LayeredConstants zenith_constants();
[[nodiscard]] HeightRange range_of(const ShadowDraw& draw, ShadowLayer layer);
// Returns for each wanted layer whether the whole mesh, a part (clipped) or nothing is in its
// heights.
[[nodiscard]] LayerSources cut_layers(const ShadowDraw& draw, const CachedCaster& caster);
// Returns positions and kernels in the own frame, where sliding and turning don't change them, and
// counts them.
[[nodiscard]] std::vector<CasterVertex> own_vertices(const OwnFrame& own,
                                                     std::span<const glm::vec3> positions,
                                                     std::span<const glm::vec3> kernels,
                                                     RenderWork& work);
// Moves vertices that rounding put below the plane onto it.
void settle_contact(std::vector<CasterVertex>& vertices);

class ShadowGeometry {
 public:
  ShadowGeometry(CasterCache& casters, const CameraModel& camera);

  // Makes the geometry of a shadow, or keeps the prepared one; `masked`: for a mask.
  void prepare(const ShadowDraw& draw, CachedCaster& caster, bool masked, PreparedShadow& prepared,
               RenderWork& work) const;
  // Returns the coarsest of the caster's surfaces whose shadow follows the lens where it is nearest
  // to the camera. Depends on the present frame alone.
  [[nodiscard]] std::size_t surface_for(const ShadowDraw& draw, const FramePlan& plan,
                                        const CachedCaster& caster,
                                        const PreparedShadow& prepared) const;
  // Returns bounds at heights from `from` upwards; nothing for lights of one size and for fields,
  // whose bounds are unknown beforehand.
  std::optional<ShadowReach> reach_of(const Scene& scene, const ShadowDraw& draw, double from,
                                      RenderWork& work) const;

  [[nodiscard]] CasterCache& casters() const { return casters_; }

 private:
  void place_layers(const ShadowDraw& draw, CachedCaster& caster, KernelSet& kernels,
                    PreparedShadow& prepared, RenderWork& work) const;
  void image_layers(const ShadowDraw& draw, CachedCaster& caster, KernelSet& kernels,
                    PreparedShadow& prepared, RenderWork& work) const;
  void make_field(const ShadowDraw& draw, CachedCaster& caster, PreparedShadow& prepared,
                  RenderWork& work) const;

  CasterCache& casters_;
  double edge_at_unit_depth_ = 0.0;  // longest edge that follows the lens 1 m from the camera [m]
  float longest_cut_edge_ = 0.0F;    // the same at the nearest distance; 0: without distortion
  // Size of a pixel at the nearest distance: finer cells would not be seen [m].
  double finest_field_cell_ = 0.0;
};

}  // namespace penumbra
