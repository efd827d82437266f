// What a shadow on one plane is drawn from: the geometry of its layers, made on the CPU and kept
// while its caster only slides or turns on the plane.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/passes/caster_cache.hpp"
#include "render/passes/field_quad.hpp"
#include "render/render_work.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"
#include "render/shadow/layers/own_frame.hpp"

namespace penumbra {

// Geometry of a receiver's shadows is freed after this number of frames without use.
inline constexpr std::uint64_t kFramesKept = 150;

// Tilt and height of layers are kept to float precision; those of fields to 1/32 of a cell.
inline constexpr int kLayerBits = 26;

enum class LayerSource {
  nothing,
  whole,           // the mesh, projected by the vertex shader
  placed,          // the mesh's vertices projected on the CPU, with those added for the lens
  clipped,         // faces cut at a height, or split on the CPU
  field,           // a field's texture
  masked,          // in the plane's mask, by silhouettes
  masked_faces,    // in the mask, face by face: open or cut meshes
  masked_outline,  // in the mask, by a field's outline
};
using LayerSources = std::array<LayerSource, 3>;

// The outlines of each layer of a field, own frame.
using FieldOutlines = std::array<std::vector<OutlineSide>, 3>;

struct LayerGeometry {
  LayerSource source = LayerSource::nothing;
  int first = 0;  // vertices in the clipped buffer
  int count = 0;
};

// The inputs of one shadow, and its buffers on the GPU.
struct PreparedShadow {
  bool valid = false;
  OwnFrame own;
  LayeredConstants constants;
  ShadowTechnique technique = ShadowTechnique::layered;
  LightMode light_mode = LightMode::proportional;
  bool reduced = false;  // the proxy casts
  bool masked = false;   // in the plane's mask
  std::array<bool, 3> wanted{};
  KernelKey kernel_key;
  std::array<LayerGeometry, 3> layers;
  std::size_t surface = 0;  // index of the caster's range that is fine enough in this frame
  // Of placed layers: the largest ratio of a long edge's image to the edge.
  double magnification = 1.0;
  std::array<VertexArray, 3> placed_layouts;
  GlBuffer placed{BufferUse::vertices};
  VertexArray clipped_layout;
  GlBuffer clipped{BufferUse::vertices};
  bool clipped_layout_made = false;
  FieldTexture field;
  std::shared_ptr<const FieldOutlines> outlines;  // of a field in a mask
  std::uint64_t last_used = 0;                    // frame, of shadows on receivers

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

// What of a shadow's layers meets heights above its plane, from one upwards.
struct ShadowReach {
  // In (u, v) of the plane [m], of all layers at all of these heights; empty: nothing casts there.
  Eigen::AlignedBox2d box;
  double low = 0.0;   // of what casts there, above the plane [m]
  double rate = 0.0;  // how far outlines move with the receiving height, at most [m / m]
};

// Factor of each layer on the encoded value of the video.
[[nodiscard]] glm::vec3 layer_light(const ShadowDraw& draw);

// A simple shadow is the middle layer of a light at the zenith, whatever the node's own.
[[nodiscard]] LayeredConstants zenith_constants();
[[nodiscard]] HeightRange range_of(const ShadowDraw& draw, ShadowLayer layer);
// Tells for each wanted layer whether all of the mesh, a part, or nothing is in its heights.
[[nodiscard]] LayerSources cut_layers(const ShadowDraw& draw, const CachedCaster& caster);
// Positions and kernels in the own frame: sliding and turning leave them as they are.
[[nodiscard]] std::vector<CasterVertex> own_vertices(const OwnFrame& own,
                                                     std::span<const glm::vec3> positions,
                                                     std::span<const glm::vec3> kernels);
// Own vertices of what stands on the plane are not cut by rounding.
void settle_contact(std::vector<CasterVertex>& vertices);

class ShadowGeometry {
 public:
  ShadowGeometry(CasterCache& casters, const CameraModel& camera);

  // Makes the geometry of a shadow, or keeps what is prepared; `masked`: for a mask.
  void prepare(const ShadowDraw& draw, CachedCaster& caster, bool masked, PreparedShadow& prepared,
               RenderWork& work) const;
  // The coarsest of the caster's surfaces whose shadow still follows the lens where it is nearest
  // to the camera. Depends on the present frame alone: the same placement and pose give the same
  // image.
  [[nodiscard]] std::size_t surface_for(const ShadowDraw& draw, const FramePlan& plan,
                                        const CachedCaster& caster,
                                        const PreparedShadow& prepared) const;
  // Bounds of a shadow at heights from `from` upwards; none where they are not known beforehand: of
  // lights of one size, and of fields.
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
  double edge_at_unit_depth_ = 0.0;  // 1 m from the camera, the longest that follows the lens [m]
  // A pixel at the nearest distance expected: finer cells of a field would not be seen [m].
  double finest_field_cell_ = 0.0;
};

}  // namespace penumbra
