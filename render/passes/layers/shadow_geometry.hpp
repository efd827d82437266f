// Computes the geometry of a shadow's layers on one plane on the CPU and reuses it while the caster
// only translates or rotates in the plane.
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

// Number of frames without use after which the geometry of a receiver's shadows is freed.
inline constexpr std::uint64_t kFramesKept = 150;

enum class LayerSource {
  nothing,
  whole,           // the mesh, projected by the vertex shader
  placed,          // vertices projected on the CPU, including those added for the lens
  clipped,         // faces clipped at a height, or split, on the CPU
  field,           // a field's texture
  masked,          // in the plane's mask, by silhouettes
  masked_faces,    // in the mask, face by face: open or clipped meshes
  masked_outline,  // in the mask, by a field's outline
};
using LayerSources = std::array<LayerSource, 3>;

// Outlines of each layer of a field, own frame.
using FieldOutlines = std::array<std::vector<OutlineSide>, 3>;

struct LayerGeometry {
  LayerSource source = LayerSource::nothing;
  int first = 0;  // first vertex in the clipped buffer
  int count = 0;
};

// The inputs of a shadow's geometry, except the own frame.
struct ShadowKey {
  ShadowTechnique technique = ShadowTechnique::layered;
  LightMode light_mode = LightMode::proportional;
  LayeredConstants constants;    // default for simple shadows
  double pose_s = 0.0;           // see PosedModel
  std::array<bool, 3> layers{};  // wanted layers; none for fields, which compute all
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
  std::size_t surface = 0;  // index into CasterBody::ranges that is fine enough in this frame
  // Maximum ratio of a projected long edge to the edge, over placed layers.
  double magnification = 1.0;
  std::array<VertexArray, 3> placed_layouts;
  GlBuffer placed{BufferUse::vertices};
  GlMesh clipped{3, 2};  // (u, v, h) and (ku, kv)
  FieldTexture field;
  std::shared_ptr<const FieldOutlines> outlines;  // outlines of a masked field; else null
  std::uint64_t last_used = 0;                    // frame number, for shadows on receivers

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

// Bounds of a shadow's layers at all receiving heights above a given height.
struct ShadowReach {
  // (u, v) on the plane [m]; empty: no shadow at these heights.
  Eigen::AlignedBox2d box;
  double low = 0.0;   // lowest height of the casting faces [m]
  double rate = 0.0;  // maximum shift of outlines per receiving height [m / m]
};

// Returns each layer's factor on the encoded value of the video.
[[nodiscard]] glm::vec3 layer_light(const ShadowDraw& draw);

// Returns the constants of a simple shadow: the middle layer of a light at the zenith.
[[nodiscard]] LayeredConstants zenith_constants();
[[nodiscard]] HeightRange range_of(const ShadowDraw& draw, ShadowLayer layer);
// Returns, for each wanted layer, whether the whole mesh, a part of it (clipped) or nothing is in
// the layer's height range.
[[nodiscard]] LayerSources layer_sources(const ShadowDraw& draw, const CachedCaster& caster);
// Returns positions and kernels in the own frame, and counts them in `work`.
[[nodiscard]] std::vector<CasterVertex> own_vertices(const OwnFrame& own,
                                                     std::span<const glm::vec3> positions,
                                                     std::span<const glm::vec3> kernels,
                                                     RenderWork& work);
// Moves vertices that rounding put below the plane onto the plane.
void settle_contact(std::vector<CasterVertex>& vertices);

class ShadowGeometry {
 public:
  ShadowGeometry(CasterCache& casters, const CameraModel& camera);

  // Computes the geometry of a shadow unless `prepared` is still valid. `masked`: for a mask.
  void prepare(const ShadowDraw& draw, CachedCaster& caster, bool masked, PreparedShadow& prepared,
               RenderWork& work) const;
  // Returns the coarsest of the caster's ranges whose shadow follows the lens at its nearest point
  // to the camera. Depends only on the current frame.
  [[nodiscard]] std::size_t coarsest_range(const ShadowDraw& draw, const FramePlan& plan,
                                           const CachedCaster& caster,
                                           const PreparedShadow& prepared) const;
  // Returns the bounds at heights from `from` upwards; nullopt for fixed lights and for fields,
  // whose bounds are not known in advance.
  std::optional<ShadowReach> reach_of(const Scene& scene, const ShadowDraw& draw, double from,
                                      RenderWork& work) const;

  [[nodiscard]] CasterCache& casters() const { return casters_; }

 private:
  void place_layers(const ShadowDraw& draw, CachedCaster& caster, KernelSet& kernels,
                    PreparedShadow& prepared, RenderWork& work) const;
  void project_layers(const ShadowDraw& draw, CachedCaster& caster, KernelSet& kernels,
                      PreparedShadow& prepared, RenderWork& work) const;
  void make_field(const ShadowDraw& draw, CachedCaster& caster, PreparedShadow& prepared,
                  RenderWork& work) const;

  CasterCache& casters_;
  double edge_at_unit_depth_ = 0.0;  // longest edge that follows the lens, 1 m away [m]
  float longest_cut_edge_ = 0.0F;    // such an edge at kNearestDistance; 0: no distortion
  double finest_field_cell_ = 0.0;   // size of a pixel at kNearestDistance [m]
};

}  // namespace penumbra
