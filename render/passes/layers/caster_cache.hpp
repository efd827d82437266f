// Caches casting meshes between frames: their geometry, kernels and reduced meshes.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/shadow/casters/animated_caster.hpp"
#include "render/shadow/casters/caster_geometry.hpp"
#include "render/shadow/casters/shadow_proxy.hpp"
#include "render/shadow/fields/fixed_light.hpp"
#include "render/shadow/kernels/kernel_direction.hpp"
#include "render/shadow/kernels/twist.hpp"
#include "render/shadow/layers/own_frame.hpp"
#include "render/shadow/masks/mesh_edges.hpp"

namespace penumbra {

// Returns, for each object of the scene, the maximum edge length of its caster [object units] for
// which the shadow's edges follow the lens at kNearestDistance; 0 (no splitting) without
// distortion.
[[nodiscard]] std::vector<float> longest_caster_edges(const Scene& scene,
                                                      const CameraModel& camera);

struct KernelKey {
  std::optional<KernelSource> source;  // nullopt: the technique uses no kernels
  KernelDirection direction;
  bool stored = false;  // kernels stored in the model's file
  friend auto operator<=>(const KernelKey&, const KernelKey&) = default;
};

// A casting mesh, with its faces on the GPU.
struct CasterBody {
  // An edge that was split, between two positions; object units.
  struct LongEdge {
    std::uint32_t a = 0, b = 0;
    float length = 0.0F;
  };
  struct IndexRange {
    std::size_t first = 0, count = 0;
  };

  CasterGeometry geometry;
  std::vector<LongEdge> long_edges;
  GlBuffer indices{BufferUse::indices};
  bool indices_written = false;
  std::vector<IndexRange> ranges;  // index ranges of the meshes, from coarse to fine
  // Computed on demand by can_be_masked() for the unsplit mesh: its edges if it is closed, else its
  // oriented faces if there is a consistent orientation.
  std::optional<std::vector<SharedEdge>> edges;
  std::optional<std::vector<std::uint32_t>> oriented;
  bool edges_made = false;
};

// A body's vertices with one set of kernels: { position, kernel }.
struct BodyVertices {
  bool made = false, uploaded = false;
  std::vector<glm::vec3> kernels;
  VertexArray layout;
  GlBuffer vertices{BufferUse::vertices};
};

struct KernelSet {
  ShadowKernels made;  // for the full mesh; equal to its positions if the technique uses no kernels
  BodyVertices whole, reduced;
  TwistReport twist;
  std::optional<double> overshoot;  // layer_overshoot(), computed on demand
  std::uint64_t last_used = 0;

  [[nodiscard]] const BodyVertices& vertices(bool use_reduced) const {
    return use_reduced ? reduced : whole;
  }
};

struct CachedCaster {
  struct ProxyKey {
    KernelKey kernels;
    LightMode light_mode = LightMode::proportional;
    std::array<double, 4> constants{};
    double scale = 1.0;
    friend auto operator<=>(const ProxyKey&, const ProxyKey&) = default;
  };

  std::shared_ptr<const Model> model;  // what the caster was made from
  AnimatedCaster* carrier = nullptr;   // of an animated model, if its mesh is that of the carrier
  ShadowMesh mesh;
  // Source of the kernels in the model's file, also used for other tilts.
  KernelSource stored_source = KernelSource::automatic;
  CasterBody whole;
  std::optional<ShadowProxy> proxy;     // a reduced mesh that may cast layers
  CasterBody reduced;                   // body of the proxy
  std::map<ProxyKey, bool> proxy_kept;  // whether compare_with_proxy() accepts the proxy
  glm::vec3 min_corner{0.0F};
  glm::vec3 max_corner{0.0F};
  double size = 0.0;  // largest distance of a point from the object's origin, unscaled [m]
  std::map<KernelKey, KernelSet> sets;
  // The size of each part's light. Key: direction, and whether the technique is a field (then
  // part_discs() is called without `across_joints`).
  std::map<std::pair<KernelDirection, bool>, std::vector<PartDisc>> part_sets;

  [[nodiscard]] bool is_empty() const { return whole.geometry.indices.empty(); }
  [[nodiscard]] const CasterBody& body(bool use_reduced) const {
    return use_reduced ? reduced : whole;
  }
  [[nodiscard]] const ShadowMesh& casting_mesh(bool use_reduced) const {
    return use_reduced ? proxy->mesh : mesh;
  }
  // Returns the kernels of a set, one per position of the casting mesh.
  [[nodiscard]] std::span<const glm::vec3> kernels(const KernelSet& set, bool use_reduced) const {
    return std::span<const glm::vec3>(set.vertices(use_reduced).kernels)
        .first(casting_mesh(use_reduced).positions.size());
  }
};

class CasterCache {
 public:
  CasterCache(const Scene& scene, const CameraModel& camera);

  // Starts a frame: older kernel sets may be evicted.
  void begin_frame() { ++frame_count_; }

  // Returns true if carried kernels suit an object with an animation, whose shape is in the scene.
  // The same in all frames while the object has its tilt and the light its kind, except in shapes
  // with other faces.
  [[nodiscard]] bool carries_kernels(const Scene& scene, const ShadowDraw& draw);

  CachedCaster& caster_of(const Scene& scene, const ShadowDraw& draw);

  // The mesh and kernels of a shadow. For a technique with uses_outlines, only the key is set.
  struct Casting {
    KernelKey key;
    KernelSet* kernels = nullptr;
    bool reduced = false;  // the proxy casts
  };
  // `to_gpu`: uploads the vertices, unless the CPU projects them.
  Casting casting(const ShadowDraw& draw, CachedCaster& caster, const OwnFrame& own, bool to_gpu,
                  RenderWork& work);

  // Returns the light sizes of a caster's parts, as the technique `field` has them.
  const std::vector<PartDisc>& field_parts_of(const ShadowDraw& draw, CachedCaster& caster,
                                              const KernelDirection& direction, RenderWork& work);
  // Returns the light sizes of a caster's parts.
  static const std::vector<PartDisc>& parts_of(CachedCaster& caster,
                                               const KernelDirection& direction, bool of_field,
                                               RenderWork& work);
  // Returns the discs at a casting mesh's vertices, for LightMode::fixed.
  static std::vector<VertexDisc> discs_of(CachedCaster& caster, const KernelKey& key, bool reduced,
                                          double scale, RenderWork& work);
  // Returns true if the CPU, not the vertex shader, projects the vertices.
  [[nodiscard]] static bool projects_on_cpu(const ShadowDraw& draw, const CasterBody& body);
  // Returns true if masks can be made of all meshes that may cast this shadow.
  [[nodiscard]] static bool can_be_masked(const ShadowDraw& draw, CachedCaster& caster);

 private:
  // Model, longest edge, proxy model, groups, cut-outs, and an object with an animation, whose
  // model changes and is null in the key (-1: a rigid model, which objects share).
  using Key = std::tuple<const Model*, float, const Model*, std::vector<std::string>, CutOuts, int>;

  // An object with an animation, and the edges of its mesh if this is closed.
  struct Animated {
    AnimatedCaster caster;
    std::optional<std::vector<SharedEdge>> edges = {};
    bool edges_made = false;
    std::map<int, KernelDirection> directions = {};  // by plane, when it was drawn first
  };
  Animated& animated(const Scene& scene, int object);
  [[nodiscard]] static bool has_first_tilt(Animated& caster, const ShadowDraw& draw,
                                           const KernelDirection& direction);
  [[nodiscard]] bool set_shape(const Scene& scene, int object, CachedCaster& entry);
  KernelSet& kernels_of(const ShadowDraw& draw, CachedCaster& caster, const KernelKey& key,
                        RenderWork& work);
  bool proxy_casts(const ShadowDraw& draw, CachedCaster& caster, const KernelKey& key,
                   KernelSet& set, RenderWork& work);

  // One per scene object.
  std::vector<float> edges_;    // longest_caster_edges()
  std::vector<bool> steady_;    // scale and tilt are constant
  std::vector<bool> cut_outs_;  // has_cut_outs() of its model
  std::map<Key, std::unique_ptr<CachedCaster>> casters_;
  std::map<int, Animated> animated_;  // by object
  std::uint64_t frame_count_ = 0;
};

}  // namespace penumbra
