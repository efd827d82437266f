#include "render/passes/shadow_pass.hpp"

#include <epoxy/gl.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <glm/common.hpp>
#include <limits>
#include <map>
#include <optional>
#include <set>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "render/passes/lens_uniforms.hpp"
#include "render/passes/object_pass.hpp"
#include "render/shadow/caster.hpp"
#include "render/shadow/fields/fixed_light.hpp"
#include "render/shadow/kernels/kernel_file.hpp"
#include "render/shadow/kernels/kernel_stamp.hpp"
#include "render/shadow/masks/cut_out.hpp"

namespace penumbra {
namespace {

// A caster that stands on the plane is not cut by rounding: this far below the plane (or above a
// clip height) still counts as within [m].
constexpr double kContactTolerance = 1e-6;
constexpr std::size_t kMaxKernelSets = 64;  // kept per caster
constexpr std::size_t kMaxProxyChecks = 4096;
constexpr double kPixelsPerMaskCell = 1.6;
// Where it is known how near what is seen of a shadow is, and not only all of it: the edges of the
// coarsest of these have 6 codes RMS, as far as the other's reach in pictures.
constexpr double kPixelsPerSeenCell = 1.35;
constexpr std::int64_t kMostMaskSide = 8192;  // cells, if the driver has textures as large
constexpr int kMaskCellsAtOnce = 1 << 20;
// Of all casters on a plane, as many as are drawn directly where edges are smooth anyway
// (rendering.md 3). A mask takes the CPU half a million instructions and more, drawing directly a
// few thousand, and the rest is the GPU's (BENCHMARKS.md).
constexpr std::size_t kFewFaces = 500;

// One cell around, with all of the light.
MaskCells cells_about(const Eigen::AlignedBox<std::int64_t, 2>& box, double cell) {
  return MaskCells{cell, box.min().x() - 1, box.min().y() - 1,
                   static_cast<int>(box.sizes().x()) + 3, static_cast<int>(box.sizes().y()) + 3};
}
// A reduced mesh whose edges were split again for the lens must still spare this much.
constexpr double kWorthwhileFaces = 0.75;
// Tilt and height of layers are kept to what floats can tell; those of fields to 1/32 of a cell.
constexpr int kLayerBits = 26;
constexpr int kFieldBits = 13;
// Factors between which faces are tested for twists: from an umbra that has almost vanished to a
// penumbra at 0.65 of that height.
constexpr double kLeastFactor = 0.05;
constexpr double kGreatestFactor = 1.65;

std::array<bool, 3> wanted_layers(const ShadowDraw& draw) {
  return {draw.umbra, draw.middle, draw.penumbra};
}

// A simple shadow is the middle layer of a light at the zenith, whatever the node's own.
LayeredConstants zenith_of_simple() {
  LayeredConstants constants;
  constants.light_height = std::numeric_limits<double>::infinity();
  constants.umbra_height = 1.0;
  return constants;
}

HeightRange range_of(const ShadowDraw& draw, ShadowLayer layer) {
  if (draw.technique == ShadowTechnique::simple)
    return {0.0, std::numeric_limits<double>::infinity()};
  return layer_height_range(draw.constants, layer);
}

// Heights above the plane of object points: n . (position + R s p - q).
struct HeightMap {
  Eigen::Vector3d gradient;
  double offset;

  HeightMap(const PlaneFrame& plane, const Placement& T)
      : gradient(T.scale * (T.rotation.conjugate() * plane.n)), offset(plane.height(T.position)) {}
  [[nodiscard]] double operator()(const glm::vec3& p) const {
    return gradient.dot(Eigen::Vector3d(static_cast<double>(p.x), static_cast<double>(p.y),
                                        static_cast<double>(p.z))) +
           offset;
  }
};

// Lowest and highest point: of the box, which is enough in most frames, or of the vertices.
HeightRange box_heights(const HeightMap& height, const glm::vec3& low, const glm::vec3& high) {
  HeightRange range{height(low), height(low)};
  for (int i = 1; i < 8; ++i) {
    const double h = height({(i & 1) != 0 ? high.x : low.x, (i & 2) != 0 ? high.y : low.y,
                             (i & 4) != 0 ? high.z : low.z});
    range.low = std::min(range.low, h);
    range.high = std::max(range.high, h);
  }
  return range;
}
HeightRange vertex_heights(const HeightMap& height, const std::vector<glm::vec3>& positions) {
  HeightRange range{std::numeric_limits<double>::infinity(),
                    -std::numeric_limits<double>::infinity()};
  for (const glm::vec3& p : positions) {
    const double h = height(p);
    range.low = std::min(range.low, h);
    range.high = std::max(range.high, h);
  }
  return range;
}

// Inside by no more than rounding.
bool within(const HeightRange& heights, const HeightRange& range) {
  return heights.low >= range.low - kContactTolerance &&
         heights.high <= range.high + kContactTolerance;
}
bool apart(const HeightRange& heights, const HeightRange& range) {
  return heights.high < range.low - kContactTolerance ||
         heights.low > range.high + kContactTolerance;
}

// Share of the light that is left -> factor for the video's encoded value: darkening linear light
// by k is multiplying the encoded value by k^(1/exponent). Fades to 1 with the overlay's opacity.
float encoded_factor(double light_fraction, double tone_exponent, float opacity) {
  const double factor = std::pow(std::clamp(light_fraction, 0.0, 1.0), 1.0 / tone_exponent);
  return static_cast<float>(1.0 - static_cast<double>(opacity) * (1.0 - factor));
}

// (u, v, h) of the own frame -> of the plane.
glm::mat4x3 plane_from_own(const PlanarMotion& T) {
  const auto c = static_cast<float>(T.cosine);
  const auto s = static_cast<float>(T.sine);
  return {glm::vec3(c, s, 0.0F), glm::vec3(-s, c, 0.0F), glm::vec3(0.0F, 0.0F, 1.0F),
          glm::vec3(static_cast<float>(T.slide.x()), static_cast<float>(T.slide.y()), 0.0F)};
}

// How much longer than the caster's edge its shadow's can be: the penumbra's factor at the greatest
// height that the object comes to.
std::vector<double> largest_magnifications(const Scene& scene) {
  std::vector<double> magnifications(scene.objects.size(), 1.0);
  std::map<int, std::vector<double>> heights_over;  // a plane
  for (const ShadowNode& node : scene.shadows) {
    const HeightRange range = layer_height_range(node.layered, ShadowLayer::penumbra);
    for (const int plane : node.planes) {
      std::vector<double>& heights = heights_over[plane];
      if (heights.empty()) {
        const ScenePlane& at = scene.planes[static_cast<std::size_t>(plane)];
        heights = greatest_heights(scene, at.normal, at.point);
      }
      for (const int caster : node.casters) {
        const auto i = static_cast<std::size_t>(caster);
        const double height = std::clamp(heights[i], range.low, range.high);
        magnifications[i] =
            std::max(magnifications[i], layer_factor(node.layered, ShadowLayer::penumbra, height));
      }
    }
  }
  return magnifications;
}

}  // namespace

namespace {

// Times at which a scene's objects are looked at: their keys, between them, and around a spin.
std::set<double> telling_times(const Scene& scene) {
  constexpr std::size_t kMostKeys = 32;  // of one object
  constexpr int kSpinSteps = 8;
  std::set<double> times = {0.0};
  for (const SceneObject& object : scene.objects) {
    const std::vector<Keyframe>& keys = object.animation.keyframes;
    for (std::size_t i = 0; i < keys.size(); i += 1 + keys.size() / kMostKeys) {
      times.insert(keys[i].time_s);
      if (i > 0) times.insert(0.5 * (keys[i].time_s + keys[i - 1].time_s));
    }
    const double rate = std::abs(object.animation.spin_turns_per_s);
    for (int i = 1; rate > 0.0 && i < kSpinSteps; ++i) times.insert(i / (kSpinSteps * rate));
  }
  return times;
}

// The group of tags that the object moves with, by its root.
const std::string& group_of(const Scene& scene, int object) {
  const SceneObject* at = &scene.objects[static_cast<std::size_t>(object)];
  while (at->parent >= 0) at = &scene.objects[static_cast<std::size_t>(at->parent)];
  return at->tag_group;
}

// Of each object, whether its scale and the tilt that its kernels are for stay the same: a proxy is
// compared once for each, which costs as much as it spares in many frames. Two groups of tags tilt
// against each other at any time.
std::vector<bool> steady_casters(const Scene& scene) {
  std::vector<bool> steady(scene.objects.size(), true);
  for (const ShadowNode& node : scene.shadows) {
    for (const int plane : node.planes) {
      const std::string& group = scene.planes[static_cast<std::size_t>(plane)].tag_group;
      for (const int caster : node.casters) {
        const auto i = static_cast<std::size_t>(caster);
        steady[i] = steady[i] && group_of(scene, caster) == group;
      }
    }
  }
  const SceneState start = evaluate_scene(scene, 0.0);
  for (const double time : telling_times(scene)) {
    const SceneState state = evaluate_scene(scene, time);
    for (const ShadowNode& node : scene.shadows) {
      for (const int plane : node.planes) {
        const Eigen::Vector3d& up = scene.planes[static_cast<std::size_t>(plane)].normal;
        const auto tilt = [&up](const Placement& placement) {
          return KernelDirection::nearest(placement.rotation.conjugate() * up);
        };
        for (const int caster : node.casters) {
          const auto i = static_cast<std::size_t>(caster);
          const Placement& now = state.objects[i];
          const Placement& before = start.objects[i];
          steady[i] = steady[i] && now.scale == before.scale && tilt(now) == tilt(before);
        }
      }
    }
  }
  return steady;
}

}  // namespace

glm::vec3 layer_light(const ShadowDraw& draw) {
  const auto factor = [&draw](double fraction) {
    return encoded_factor(fraction, draw.tone_exponent, draw.opacity);
  };
  return {factor(draw.fractions.umbra), factor(draw.fractions.middle),
          factor(draw.fractions.penumbra)};
}

std::vector<float> longest_caster_edges(const Scene& scene, const CameraModel& camera) {
  if (!camera.has_distortion()) return std::vector<float>(scene.objects.size(), 0.0F);
  const double longest = longest_edge(camera);
  const std::vector<double> scales = largest_scales(scene);
  const std::vector<double> magnifications = largest_magnifications(scene);
  std::vector<float> edges;
  for (std::size_t i = 0; i < scales.size(); ++i) {
    edges.push_back(longest_model_edge(longest, scales[i] * magnifications[i]));
  }
  return edges;
}

Result<ShadowPass> ShadowPass::create(GlApi api, const Scene& scene, const CameraModel& camera,
                                      int samples) {
  constexpr std::array<std::string_view, 2> kVertex = {"lens.glsl", "shadow.vert.glsl"};
  constexpr std::array<std::string_view, 1> kFragment = {"shadow.frag.glsl"};
  PENUMBRA_TRY(auto shadow, TranslucentProgram::create(api, kVertex, kFragment, {}, Under::video));
  PENUMBRA_TRY(auto field, FieldQuad::create(api, longest_edge(camera)));
  PENUMBRA_TRY(auto mask, MaskQuad::create(api, longest_edge(camera)));
  PENUMBRA_TRY(auto strips, MeshStrips::create(api, camera));
  ShadowPass pass(std::move(shadow), std::move(field), std::move(mask), std::move(strips));
  pass.edges_ = longest_caster_edges(scene, camera);
  pass.steady_ = steady_casters(scene);
  for (const SceneObject& object : scene.objects) {
    pass.cut_outs_.push_back(object.model && has_cut_outs(*object.model));
  }
  pass.edge_at_unit_depth_ = longest_edge(camera) / kNearestDistance;
  pass.finest_field_cell_ =
      kNearestDistance / std::max(camera.parameters().fx, camera.parameters().fy);
  pass.pixel_at_unit_depth_ = 1.0 / std::max(camera.parameters().fx, camera.parameters().fy);
  pass.frustum_ = make_frustum(camera);
  pass.smooth_edges_ = samples > 0;
  GLint most_side = 0;
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &most_side);
  pass.most_mask_side_ = std::min<std::int64_t>(kMostMaskSide, most_side);
  return pass;
}

void ShadowPass::set_geometry(Body& body, const ShadowMesh& mesh, float max_edge) {
  body.geometry = split_long_edges(mesh, max_edge);
  if (body.geometry.coarser.empty()) return;
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const std::uint32_t a = mesh.indices[i + corner];
      const std::uint32_t b = mesh.indices[i + (corner + 1) % 3];
      const float length = glm::distance(mesh.positions[a], mesh.positions[b]);
      if (length > max_edge) body.long_edges.push_back({a, b, length});
    }
  }
}

ShadowPass::Caster& ShadowPass::caster_of(const Scene& scene, const ShadowDraw& draw) {
  const auto index = static_cast<std::size_t>(draw.object);
  const SceneObject& object = scene.objects[index];
  const float edge = edges_[index];
  // Kernels are of whole faces.
  const CutOuts cut_outs = cut_outs_[index] && draw.technique != ShadowTechnique::layered
                               ? CutOuts::what_is_seen
                               : CutOuts::whole_faces;
  auto& entry =
      casters_[{object.model.get(), edge, object.proxy_model.get(), object.groups, cut_outs}];
  if (!entry) {
    entry = std::make_unique<Caster>();
    entry->mesh = make_shadow_mesh(*object.model, object.groups, cut_outs);
    entry->stored_source = stored_kernel_source(*object.model);
    set_geometry(entry->whole, entry->mesh, edge);
    if (cut_outs == CutOuts::whole_faces && object.proxy_model) {
      entry->proxy = proxy_from_model(entry->mesh, *object.proxy_model);
      set_geometry(entry->reduced, entry->proxy->mesh, edge);
      const auto most =
          kWorthwhileFaces * static_cast<double>(entry->whole.geometry.indices.size());
      const std::size_t faces = entry->reduced.geometry.indices.size();
      if (faces == 0 || static_cast<double>(faces) > most) entry->proxy.reset();
    }
    if (!entry->mesh.positions.empty()) {
      entry->min_corner = entry->max_corner = entry->mesh.positions.front();
      for (const glm::vec3& p : entry->mesh.positions) {
        entry->min_corner = glm::min(entry->min_corner, p);
        entry->max_corner = glm::max(entry->max_corner, p);
        entry->size = std::max(entry->size, static_cast<double>(glm::length(p)));
      }
    }
  }
  return *entry;
}

ShadowPass::KernelSet& ShadowPass::kernels_of(Caster& caster, const KernelKey& key,
                                              ShadowWork& work) {
  const auto found = caster.sets.find(key);
  if (found != caster.sets.end()) {
    found->second.last_used = frame_count_;
    return found->second;
  }
  if (caster.sets.size() >= kMaxKernelSets) {
    const auto oldest = std::ranges::min_element(
        caster.sets, {}, [](const auto& entry) { return entry.second.last_used; });
    if (oldest->second.last_used != frame_count_) caster.sets.erase(oldest);
  }
  KernelSet& set = caster.sets[key];
  set.last_used = frame_count_;
  if (!key.source) {
    set.made.kernels = caster.mesh.positions;
    return set;
  }
  if (key.stored) {
    set.made = stored_kernels_of(caster.mesh);
  } else {
    set.made = generate_kernels(caster.mesh, key.direction.up(), *key.source);
    ++work.kernel_generations;
  }
  const TwistReport twists =
      find_twists(place_caster(caster.mesh, set.made, Placement(),
                               PlaneFrame::make(key.direction.up(), Eigen::Vector3d::Zero())),
                  caster.mesh.indices, kLeastFactor, kGreatestFactor);
  work.faces_tested += static_cast<std::int64_t>(twists.faces_tested);
  work.faces_twisted += static_cast<std::int64_t>(twists.faces_twisted);
  set.twist = twists;
  return set;
}

// Stored kernels come without radii; those of generated ones for the same direction serve.
void ShadowPass::complete_set(Caster& caster, KernelSet& set, ShadowWork& work) {
  if (complete_radii(set.made, caster.mesh, set.made.up)) ++work.kernel_generations;
}

// The body's faces, and its kernels; on the GPU those too where it projects them.
void ShadowPass::write_vertices(Caster& caster, KernelSet& set, bool reduced, bool to_gpu) {
  BodyVertices& vertices = reduced ? set.reduced : set.whole;
  Body& body = reduced ? caster.reduced : caster.whole;
  if (!vertices.made) {
    vertices.made = true;
    vertices.kernels =
        level_kernels(body.geometry, reduced ? carried_kernels(*caster.proxy, set.made) : set.made);
  }
  if (!body.indices_written) {
    std::vector<std::uint32_t> all;
    const auto add = [&](const std::vector<std::uint32_t>& indices) {
      body.ranges.push_back({all.size(), indices.size()});
      all.insert(all.end(), indices.begin(), indices.end());
    };
    for (const CasterGeometry::Coarser& coarser : body.geometry.coarser) add(coarser.indices);
    add(body.geometry.indices);
    vertices.layout.bind();
    body.indices.write(std::span<const std::uint32_t>(all));
    body.indices_written = true;
  }
  if (!to_gpu || vertices.uploaded) return;
  vertices.uploaded = true;
  std::vector<glm::vec3> interleaved;
  interleaved.reserve(2 * vertices.kernels.size());
  for (std::size_t i = 0; i < vertices.kernels.size(); ++i) {
    interleaved.push_back(body.geometry.positions[i]);
    interleaved.push_back(vertices.kernels[i]);
  }
  vertices.layout.bind();
  vertices.vertices.write(std::span<const glm::vec3>(interleaved));
  VertexArray::attribute(0, 3, 2 * sizeof(glm::vec3), 0);
  VertexArray::attribute(1, 3, 2 * sizeof(glm::vec3), sizeof(glm::vec3));
  body.indices.bind();
}

// Whether image_layers() projects a body's vertices, and not the vertex shader.
bool ShadowPass::is_imaged(const ShadowDraw& draw, const Body& body) {
  return draw.technique == ShadowTechnique::layered &&
         (draw.light_mode == LightMode::fixed || !body.geometry.coarser.empty());
}

// Decided by the tilt alone, whatever was drawn before: the same view has the same shadow.
bool ShadowPass::proxy_casts(const ShadowDraw& draw, Caster& caster, const KernelKey& key,
                             KernelSet& set, ShadowWork& work) {
  if (!caster.proxy || !draw.proxy || draw.technique != ShadowTechnique::layered) return false;
  if (!steady_[static_cast<std::size_t>(draw.object)]) return false;
  const LayeredConstants& c = draw.constants;
  const ProxyKey proxy_key{key,
                           draw.light_mode,
                           {c.light_height, c.light_ratio, c.umbra_height, c.magnification_cap},
                           draw.T_table_object.scale};
  const auto known = caster.proxy_kept.find(proxy_key);
  if (known != caster.proxy_kept.end()) return known->second;
  if (caster.proxy_kept.size() >= kMaxProxyChecks) caster.proxy_kept.clear();
  std::span<const PartDisc> parts;
  if (draw.light_mode == LightMode::fixed) {
    complete_set(caster, set, work);
    parts = parts_of(caster, key.direction, false, work);
  }
  ++work.proxy_checks;
  const ProxyUse use{c, draw.light_mode, draw.T_table_object.scale};
  const bool kept =
      compare_with_proxy(caster.mesh, set.made, parts, *caster.proxy, use, false).kept();
  caster.proxy_kept.emplace(proxy_key, kept);
  return kept;
}

const std::vector<PartDisc>& ShadowPass::parts_of(Caster& caster, const KernelDirection& direction,
                                                  bool of_field, ShadowWork& work) {
  const std::pair key(direction, of_field);
  const auto found = caster.part_sets.find(key);
  if (found != caster.part_sets.end()) return found->second;
  // A few bytes for each part: when there are too many, all are forgotten.
  if (caster.part_sets.size() >= 4 * kMaxKernelSets) caster.part_sets.clear();
  ++work.kernel_generations;
  return caster.part_sets
      .emplace(key, part_discs(caster.mesh, direction.up(), kHalfFieldCell, !of_field))
      .first->second;
}

void ShadowPass::upload_clipped(std::span<const CasterVertex> faces, Prepared& prepared) {
  // (u, v, h) and (ku, kv, 0), laid out as the whole caster is; the missing third coordinate is 0.
  prepared.clipped_layout.bind();
  prepared.clipped.write(faces, BufferLife::every_frame);
  if (!prepared.clipped_layout_made) {
    VertexArray::attribute(0, 3, sizeof(CasterVertex), offsetof(CasterVertex, u));
    VertexArray::attribute(1, 2, sizeof(CasterVertex), offsetof(CasterVertex, ku));
    prepared.clipped_layout_made = true;
  }
}

namespace {

// What stands on the plane is not cut by rounding.
float at_contact(float h) {
  return h < 0.0F && static_cast<double>(h) > -kContactTolerance ? 0.0F : h;
}

// In the own frame: sliding and turning leave the faces as they are.
std::vector<CasterVertex> own_vertices(const OwnFrame& own, std::span<const glm::vec3> positions,
                                       std::span<const glm::vec3> kernels) {
  const PlaneMap map = plane_map(own.T_own_object, PlaneFrame());
  std::vector<CasterVertex> vertices;
  vertices.reserve(positions.size());
  const auto to_own = [&](const glm::vec3& p) -> Eigen::Vector3d {
    return map.linear * Eigen::Vector3d(static_cast<double>(p.x), static_cast<double>(p.y),
                                        static_cast<double>(p.z)) +
           map.offset;
  };
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const Eigen::Vector3d x = to_own(positions[i]);
    const Eigen::Vector3d k = to_own(kernels[i]);
    vertices.push_back({static_cast<float>(x.x()), static_cast<float>(x.y()),
                        static_cast<float>(x.z()), static_cast<float>(k.x()),
                        static_cast<float>(k.y())});
  }
  return vertices;
}

}  // namespace

void ShadowPass::clip_layers(const ShadowDraw& draw, const Caster& caster, const KernelSet& kernels,
                             Prepared& prepared, ShadowWork& work) {
  const Body& body = prepared.reduced ? caster.reduced : caster.whole;
  const std::vector<CasterVertex> vertices =
      own_vertices(prepared.own, body.geometry.positions,
                   (prepared.reduced ? kernels.reduced : kernels.whole).kernels);
  work.vertices += static_cast<std::int64_t>(vertices.size());

  std::vector<CasterVertex> clipped;
  for (std::size_t i = 0; i < 3; ++i) {
    LayerGeometry& layer = prepared.layers[i];
    if (layer.source != LayerSource::clipped) continue;
    const HeightRange range = range_of(draw, kShadowLayers[i]);
    // Middle and penumbra are cut alike: one copy serves both.
    if (i == 2 && prepared.layers[1].source == LayerSource::clipped &&
        range_of(draw, ShadowLayer::middle).high == range.high) {
      layer = prepared.layers[1];
      continue;
    }
    const std::vector<CasterVertex> faces = clip_to_heights(vertices, body.geometry.indices, range);
    layer.first = static_cast<int>(clipped.size());
    layer.count = static_cast<int>(faces.size());
    clipped.insert(clipped.end(), faces.begin(), faces.end());
  }
  upload_clipped(clipped, prepared);
}

void ShadowPass::upload_placed(const std::array<std::vector<PlanePoint>, 3>& images,
                               const Body& body, Prepared& prepared) const {
  std::vector<PlanePoint> all;
  all.reserve(3 * body.geometry.positions.size());
  std::array<std::size_t, 3> first{};
  for (std::size_t i = 0; i < 3; ++i) {
    first[i] = all.size();
    all.insert(all.end(), images[i].begin(), images[i].end());
  }
  for (std::size_t i = 0; i < 3; ++i) {
    if (images[i].empty()) continue;
    // Position and kernel are the same place on the plane, where every factor is 1.
    prepared.placed_layouts[i].bind();
    if (i == 0 || first[i] == 0) {
      prepared.placed.write(std::span<const PlanePoint>(all), BufferLife::every_frame);
    } else {
      prepared.placed.bind();
    }
    for (const unsigned attribute : {0U, 1U}) {
      VertexArray::attribute(attribute, 2, sizeof(PlanePoint), first[i] * sizeof(PlanePoint));
    }
    body.indices.bind();
  }
}

// Projected here, by the functions that `penumbra shadow` uses: lights of one size, for which each
// vertex has a ratio of its own; and casters whose edges are split for the lens. A layer is the
// straight-edged image of the mesh's faces (shadows.md 2.2), and what splitting adds lies on those
// edges. What is uploaded lies on the plane.
void ShadowPass::image_layers(const ShadowDraw& draw, Caster& caster, KernelSet& kernels,
                              Prepared& prepared, ShadowWork& work) {
  const bool fixed = draw.light_mode == LightMode::fixed;
  const Body& body = prepared.reduced ? caster.reduced : caster.whole;
  const ShadowMesh& mesh = prepared.reduced ? caster.proxy->mesh : caster.mesh;
  const Placement& T_own_object = prepared.own.T_own_object;
  // Level with their vertices, so that within the threshold of tilt they stay where they are.
  const std::vector<glm::vec3>& levelled =
      (prepared.reduced ? kernels.reduced : kernels.whole).kernels;
  std::vector<CasterVertex> vertices =
      own_vertices(prepared.own, mesh.positions,
                   std::span<const glm::vec3>(levelled).first(mesh.positions.size()));
  for (CasterVertex& vertex : vertices) vertex.h = at_contact(vertex.h);
  work.vertices += static_cast<std::int64_t>(vertices.size());
  std::vector<VertexDisc> discs;
  if (fixed) {
    complete_set(caster, kernels, work);
    const std::vector<PartDisc>& parts =
        parts_of(caster, prepared.kernel_key.direction, false, work);
    discs = prepared.reduced ? vertex_discs(mesh, carried_kernels(*caster.proxy, kernels.made),
                                            parts, T_own_object.scale)
                             : vertex_discs(mesh, kernels.made, parts, T_own_object.scale);
  }
  const float edge = edges_[static_cast<std::size_t>(draw.object)];
  // Cut faces are split to what the nearest distance asks for: the camera may come nearer.
  const auto longest =
      edge > 0.0F ? static_cast<float>(edge_at_unit_depth_ * kNearestDistance) : 0.0F;
  prepared.magnification = 1.0;
  std::array<std::vector<PlanePoint>, 3> images;
  std::vector<CasterVertex> cut;
  for (std::size_t i = 0; i < 3; ++i) {
    LayerGeometry& layer = prepared.layers[i];
    if (!prepared.wanted[i] || (!fixed && layer.source == LayerSource::nothing)) continue;
    const ShadowLayer which = kShadowLayers[i];
    std::optional<std::vector<PlanePoint>> whole;
    if (fixed) {
      whole = fixed_light_images(vertices, discs, draw.constants, which);
    } else if (layer.source == LayerSource::whole) {
      whole.emplace();
      for (const CasterVertex& vertex : vertices)
        whole->push_back(project_to_layer(vertex, draw.constants, which));
    }
    if (whole) {
      layer.source = LayerSource::placed;
      images[i] = std::move(*whole);
      for (const LongEdge& long_edge : body.long_edges) {
        const PlanePoint& p = images[i][long_edge.a];
        const PlanePoint& q = images[i][long_edge.b];
        const double image = static_cast<double>(std::hypot(q.u - p.u, q.v - p.v));
        prepared.magnification =
            std::max(prepared.magnification,
                     image / (T_own_object.scale * static_cast<double>(long_edge.length)));
      }
      add_midpoints(body.geometry, images[i]);
      continue;
    }
    const std::vector<PlanePoint> faces = split_long_edges(
        fixed ? fixed_light_triangles(vertices, discs, mesh.indices, draw.constants, which)
              : layer_triangles(vertices, mesh.indices, draw.constants, which),
        longest);
    if (faces.empty()) {
      layer.source = LayerSource::nothing;
      continue;
    }
    layer.source = LayerSource::clipped;
    layer.first = static_cast<int>(cut.size());
    layer.count = static_cast<int>(faces.size());
    for (const PlanePoint& p : faces) cut.push_back({p.u, p.v, 0.0F, p.u, p.v});
  }
  if (!cut.empty()) upload_clipped(cut, prepared);
  upload_placed(images, body, prepared);
}

ShadowPass::CastWith ShadowPass::cast_with(const ShadowDraw& draw, Caster& caster,
                                           const OwnFrame& own, bool to_gpu, ShadowWork& work) {
  CastWith with;
  if (draw.technique == ShadowTechnique::layered) {
    const bool stored_serve =
        draw.kernels == KernelSource::automatic &&
        (draw.light_mode == LightMode::proportional || have_thickness(caster.stored_source));
    with.key.source = stored_serve ? caster.stored_source : draw.kernels;
    // Of the own frame: turning on the plane changes nothing, not by rounding either.
    const Eigen::Vector3d up = own.T_own_object.rotation.conjugate() * Eigen::Vector3d::UnitZ();
    with.key.direction = KernelDirection::nearest(up);
    // By the tilt itself: the grid's direction may be nearly 2 degrees nearer to their own.
    with.key.stored = stored_serve && has_stored_kernels_for(caster.mesh, up);
  }
  if (draw.technique == ShadowTechnique::field) return with;
  with.kernels = &kernels_of(caster, with.key, work);
  with.reduced = proxy_casts(draw, caster, with.key, *with.kernels, work);
  const bool imaged = is_imaged(draw, with.reduced ? caster.reduced : caster.whole);
  write_vertices(caster, *with.kernels, with.reduced, to_gpu && !imaged);
  return with;
}

void ShadowPass::prepare_one(const ShadowDraw& draw, Caster& caster, Prepared& prepared,
                             bool masked, ShadowWork& work) {
  const bool field = draw.technique == ShadowTechnique::field;
  const OwnFrame own =
      OwnFrame::make(draw.T_table_object, draw.plane_frame, draw.T_table_object.scale * caster.size,
                     field ? kFieldBits : kLayerBits);
  const auto [key, kernels, reduced] = cast_with(draw, caster, own, !masked, work);
  if (reduced) ++work.proxy_shadows;
  const bool reused =
      prepared.valid && prepared.technique == draw.technique && prepared.reduced == reduced &&
      prepared.masked == masked && prepared.light_mode == draw.light_mode &&
      prepared.own.same_shape(own) && prepared.kernel_key == key &&
      (draw.technique == ShadowTechnique::simple || prepared.constants == draw.constants) &&
      (field || prepared.wanted == wanted_layers(draw));
  prepared.own = own;
  prepared.wanted = wanted_layers(draw);
  if (reused) {
    ++work.reprojections;
  } else {
    ++work.recomputed;
    prepared.valid = true;
    prepared.constants = draw.constants;
    prepared.technique = draw.technique;
    prepared.light_mode = draw.light_mode;
    prepared.reduced = reduced;
    prepared.masked = masked;
    prepared.kernel_key = key;
    prepared.magnification = 1.0;
    prepared.layers = {};
    if (field) {
      make_field(draw, caster, prepared, work);
    } else {
      place_layers(draw, caster, *kernels, prepared, work);
    }
  }
  if (field) {
    for (std::size_t i = 0; i < 3; ++i) {
      prepared.layers[i].source = LayerSource::nothing;
      if (!prepared.wanted[i]) continue;
      if (masked && !(*prepared.outlines)[i].empty())
        prepared.layers[i].source = LayerSource::masked_outline;
      if (!masked && prepared.field.layers()[i]) prepared.layers[i].source = LayerSource::field;
    }
  }
}

void ShadowPass::make_field(const ShadowDraw& draw, Caster& caster, Prepared& prepared,
                            ShadowWork& work) {
  const Placement& T_own_object = prepared.own.T_own_object;
  const PlaneFrame plane;
  const Eigen::Vector3d up = T_own_object.rotation.conjugate() * plane.n;
  const std::vector<PartDisc>& parts = parts_of(caster, KernelDirection::nearest(up), true, work);
  const PlaneMap map = plane_map(T_own_object, plane);
  // What lies on the plane is not cut by the rounding of tilt and height.
  const auto contact = static_cast<float>(
      kContactTolerance + std::ldexp(T_own_object.scale * caster.size, 2 - kFieldBits));
  std::vector<CasterVertex> vertices;
  vertices.reserve(caster.mesh.positions.size());
  for (const glm::vec3& p : caster.mesh.positions) {
    const Eigen::Vector3f x =
        (map.linear * Eigen::Vector3d(static_cast<double>(p.x), static_cast<double>(p.y),
                                      static_cast<double>(p.z)) +
         map.offset)
            .cast<float>();
    const float h = x.z() < 0.0F && x.z() > -contact ? 0.0F : x.z();
    vertices.push_back({x.x(), x.y(), h, x.x(), x.y()});
  }
  work.vertices += static_cast<std::int64_t>(vertices.size());
  ShadowFieldOptions options;
  options.finest_cell = finest_field_cell_;
  const ShadowField field =
      power_distance_layers(vertices, caster.mesh.indices, caster.mesh.part,
                            part_lights(parts, T_own_object, plane), draw.constants, options);
  if (!prepared.masked) {
    prepared.field.upload(field);
    return;
  }
  FieldOutlines outlines;
  for (std::size_t i = 0; i < 3; ++i) outlines[i] = field_outline(field, kShadowLayers[i]);
  prepared.outlines = std::make_shared<const FieldOutlines>(std::move(outlines));
}

void ShadowPass::note_empty_field(const Scene& scene, const ShadowDraw& draw, const Caster& caster,
                                  const Prepared& prepared, ShadowWork& work) {
  const auto is_empty = [](const LayerGeometry& layer) {
    return layer.source == LayerSource::nothing;
  };
  if (draw.technique != ShadowTechnique::field || !std::ranges::all_of(prepared.layers, is_empty) ||
      cut_layers(draw, caster) == std::array<LayerSource, 3>{})
    return;
  work.skipped.push_back(
      {"field_too_coarse",
       fmt::format(
           "{}: it is so large and thin that no cell of its field is covered; give it another "
           "technique",
           scene.objects[static_cast<std::size_t>(draw.object)].name)});
}

// Of each layer whether all of the mesh is in its heights, or a part, or nothing.
std::array<ShadowPass::LayerSource, 3> ShadowPass::cut_layers(const ShadowDraw& draw,
                                                              const Caster& caster) {
  const HeightMap height(draw.plane_frame, draw.T_table_object);
  const HeightRange box = box_heights(height, caster.min_corner, caster.max_corner);
  std::optional<HeightRange> exact;
  std::array<LayerSource, 3> sources{};
  const std::array<bool, 3> wanted = wanted_layers(draw);
  for (std::size_t i = 0; i < 3; ++i) {
    if (!wanted[i]) continue;
    const HeightRange range = range_of(draw, kShadowLayers[i]);
    HeightRange heights = box;
    if (!within(box, range)) {
      if (!exact) exact = vertex_heights(height, caster.mesh.positions);
      heights = *exact;
    }
    if (apart(heights, range)) continue;
    sources[i] = within(heights, range) ? LayerSource::whole : LayerSource::clipped;
  }
  return sources;
}

void ShadowPass::place_layers(const ShadowDraw& draw, Caster& caster, KernelSet& kernels,
                              Prepared& prepared, ShadowWork& work) {
  const bool fixed =
      draw.technique == ShadowTechnique::layered && draw.light_mode == LightMode::fixed;
  if (fixed && !prepared.masked) {
    image_layers(draw, caster, kernels, prepared, work);
    return;
  }
  const Body& body = prepared.reduced ? caster.reduced : caster.whole;
  const std::array<LayerSource, 3> sources = cut_layers(draw, caster);
  bool clips = false;
  for (std::size_t i = 0; i < 3; ++i) {
    if (!prepared.wanted[i]) continue;
    prepared.layers[i].source = sources[i];
    clips = clips || sources[i] == LayerSource::clipped;
    if (!prepared.masked) continue;
    // In a light of one size each part loses its umbra at a height of its own.
    if (sources[i] == LayerSource::nothing && !fixed) continue;
    const bool closes_up = sources[i] == LayerSource::whole && body.edges && !fixed;
    prepared.layers[i].source = closes_up ? LayerSource::masked : LayerSource::masked_faces;
  }
  if (prepared.masked) return;
  if (is_imaged(draw, body)) {
    image_layers(draw, caster, kernels, prepared, work);
  } else if (clips) {
    clip_layers(draw, caster, kernels, prepared, work);
  }
}

// The coarsest of the caster's surfaces whose shadow still follows the lens where it is nearest to
// the camera. Of the present frame alone: the same placement and pose give the same picture,
// whatever came before.
std::size_t ShadowPass::surface_for(const ShadowDraw& draw, const FramePlan& plan,
                                    const Caster& caster, const Prepared& prepared) const {
  const Body& body = prepared.reduced ? caster.reduced : caster.whole;
  const std::size_t finest = body.geometry.coarser.size();
  if (plan.finest_edges || finest == 0) return finest;
  std::array<Eigen::Vector3d, 8> corners;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double top = 0.0;
  for (int i = 0; i < 8; ++i) {
    const Eigen::Vector3d corner(
        static_cast<double>((i & 1) != 0 ? caster.max_corner.x : caster.min_corner.x),
        static_cast<double>((i & 2) != 0 ? caster.max_corner.y : caster.min_corner.y),
        static_cast<double>((i & 4) != 0 ? caster.max_corner.z : caster.min_corner.z));
    Eigen::Vector3d& on_plane = corners[static_cast<std::size_t>(i)];
    on_plane = draw.plane_frame.to_plane(draw.T_table_object * corner);
    centre += on_plane.head<2>() / 8.0;
    top = std::max(top, on_plane.z());
  }
  double radius = 0.0;
  for (const Eigen::Vector3d& corner : corners)
    radius = std::max(radius, (corner.head<2>() - centre).norm());
  double magnification = 1.0;
  if (draw.technique != ShadowTechnique::simple) {
    for (const ShadowLayer layer : {ShadowLayer::umbra, ShadowLayer::penumbra})
      magnification = std::max(magnification, layer_factor(draw.constants, layer, top));
  }
  // A kernel lies inside the circle round the footprint: no image is farther out than this.
  radius *= 1.05 * (2.0 * magnification - 1.0);
  const Eigen::Vector3d axis = plan.T_table_camera.rotation() * Eigen::Vector3d::UnitZ();
  const PlaneFrame& plane = draw.plane_frame;
  const Eigen::Vector3d middle = plane.q + centre.x() * plane.e1 + centre.y() * plane.e2;
  const double depth = axis.dot(middle - plan.T_table_camera.translation()) -
                       radius * std::hypot(axis.dot(plane.e1), axis.dot(plane.e2));
  if (depth <= kNearestDistance) return finest;
  const double longest =
      edge_at_unit_depth_ * depth /
      (draw.T_table_object.scale * std::max(magnification, prepared.magnification));
  for (std::size_t i = 0; i < finest; ++i) {
    if (static_cast<double>(body.geometry.coarser[i].longest_edge) <= longest) return i;
  }
  return finest;
}

std::optional<ShadowReach> ShadowPass::reach_of(const Scene& scene, const ShadowDraw& draw,
                                                double from, ShadowWork& work) {
  const bool layered =
      draw.technique == ShadowTechnique::layered && draw.light_mode == LightMode::proportional;
  if (!layered && draw.technique != ShadowTechnique::simple) return std::nullopt;
  Caster& caster = caster_of(scene, draw);
  ShadowReach reach;
  if (caster.whole.geometry.indices.empty()) return reach;
  const OwnFrame own = OwnFrame::make(draw.T_table_object, draw.plane_frame,
                                      draw.T_table_object.scale * caster.size, kLayerBits);
  const CastWith with = cast_with(draw, caster, own, false, work);
  const ShadowMesh& mesh = with.reduced ? caster.proxy->mesh : caster.mesh;
  const std::vector<glm::vec3>& kernels =
      (with.reduced ? with.kernels->reduced : with.kernels->whole).kernels;
  const std::vector<CasterVertex> vertices = own_vertices(
      own, mesh.positions, std::span<const glm::vec3>(kernels).first(mesh.positions.size()));
  work.vertices += static_cast<std::int64_t>(vertices.size());
  // A face that is cut at a height has its cut's images between those of its vertices.
  std::vector<bool> casts(vertices.size(), false);
  const double least = from - kContactTolerance;
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    const std::array<std::uint32_t, 3> face = {mesh.indices[i], mesh.indices[i + 1],
                                               mesh.indices[i + 2]};
    const bool over = std::ranges::any_of(face, [&](std::uint32_t corner) {
      return static_cast<double>(vertices[corner].h) >= least;
    });
    if (!over) continue;
    for (const std::uint32_t corner : face) casts[corner] = true;
  }
  double top = 0.0;  // above `from`
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    if (casts[i]) top = std::max(top, static_cast<double>(vertices[i].h) - from);
  }
  const LayeredConstants& c = draw.constants;
  const auto image_at = [&](const CasterVertex& vertex, double s) -> Eigen::Vector2d {
    const Eigen::Vector2d x(static_cast<double>(vertex.u), static_cast<double>(vertex.v));
    const Eigen::Vector2d k(static_cast<double>(vertex.ku), static_cast<double>(vertex.kv));
    return own.T_plane_own * Eigen::Vector2d(k + s * (x - k));
  };
  reach.low = std::numeric_limits<double>::infinity();
  double thickest = 0.0;  // of x - k
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    if (!casts[i]) continue;
    const CasterVertex& vertex = vertices[i];
    const auto h = static_cast<double>(vertex.h);
    reach.low = std::min(reach.low, h);
    reach.box.extend(image_at(vertex, 1.0));
    if (!layered) continue;
    thickest = std::max(
        thickest, static_cast<double>(std::hypot(vertex.u - vertex.ku, vertex.v - vertex.kv)));
    // Images lie between that at the vertex's own height and that at the lowest one; where faces
    // are cut, the cut's factor may be that of any of their points.
    for (const ShadowLayer layer : kShadowLayers) {
      const double highest = layer_height_range(c, layer).high;
      const double over = top > highest ? highest : std::clamp(h - from, 0.0, highest);
      reach.box.extend(image_at(vertex, layer_factor(c, layer, over)));
    }
  }
  if (layered) reach.rate = thickest * layer_rate(c, ShadowLayer::penumbra, top);
  return reach;
}

ShadowPass::Prepared& ShadowPass::prepare_level(const ReceivedShadowDraw& draw, int level,
                                                const ShadowDraw& shadow, Caster& caster,
                                                bool masked, ShadowWork& work) {
  Prepared& prepared =
      flat_prepared_[{shadow.node, shadow.object, shadow.plane, draw.receiver, level}];
  prepared.last_used = frame_count_;
  prepared.surface = 0;  // no lens: straight edges may be of any length
  if (caster.whole.geometry.indices.empty()) {
    prepared.layers = {};
    prepared.valid = false;
    return prepared;
  }
  // What is counted is of casters, planes and lights: a receiver's levels are none of their own.
  const ShadowWork before = work;
  prepare_one(shadow, caster, prepared, masked, work);
  work.reprojections = before.reprojections;
  work.recomputed = before.recomputed;
  work.proxy_shadows = before.proxy_shadows;
  return prepared;
}

std::size_t ShadowPass::prepare_flat(const Scene& scene, const ReceivedShadowDraw& draw, int level,
                                     const PlaneFrame& plane, ShadowWork& work) {
  ShadowDraw shadow = draw.shadow;
  shadow.plane_frame = plane;
  Caster& caster = caster_of(scene, shadow);
  Prepared& prepared = prepare_level(draw, level, shadow, caster, false, work);
  shadow.fractions = {1.0, 1.0, 1.0};
  flats_.emplace_back(shadow, Item{&caster, &prepared, shadow.node, shadow.object, shadow.plane,
                                   shadow.plane_frame});
  return flats_.size() - 1;
}

bool ShadowPass::covers_flat(const Scene& scene, const FramePlan& plan, const ShadowDraw& draw) {
  if (plan.layers == LayerDrawing::direct) return false;
  if (draw.technique == ShadowTechnique::field) return true;
  Caster& caster = caster_of(scene, draw);
  if (plan.layers == LayerDrawing::automatic && smooth_edges_ &&
      caster.mesh.indices.size() / 3 <= kFewFaces)
    return false;
  return is_for_masks(caster.whole, caster.mesh) &&
         (!caster.proxy || !draw.proxy || is_for_masks(caster.reduced, caster.proxy->mesh));
}

void ShadowPass::cover_flat(const Scene& scene, const ReceivedShadowDraw& draw, int level,
                            const PlaneFrame& plane, const MaskCells& cells,
                            std::span<std::uint8_t> rgba, ShadowWork& work) {
  ShadowDraw shadow = draw.shadow;
  shadow.plane_frame = plane;
  Caster& caster = caster_of(scene, shadow);
  const Prepared& prepared = prepare_level(draw, level, shadow, caster, true, work);
  std::ranges::fill(rgba, std::uint8_t{0});
  if (!prepared.valid) return;
  const MaskPart part = mask_part(shadow, caster, prepared);
  if (part.covers_nothing()) return;
  if (mask_casters_.empty()) mask_casters_.resize(1);
  MaskCaster& projected = mask_casters_.front();
  project_part(part, face_images(part, work), cells.size, projected, work);
  // However large the shadow is: only what of it is over these cells.
  using Cell = Eigen::Vector<std::int64_t, 2>;
  const Eigen::AlignedBox<std::int64_t, 2> all(
      Cell(cells.u, cells.v), Cell(cells.u + cells.width - 1, cells.v + cells.height - 1));
  const Eigen::AlignedBox<std::int64_t, 2> over = all.intersection(projected.bounds());
  if (over.isEmpty()) return;
  mask_picture_.begin({cells.size, over.min().x(), over.min().y(),
                       static_cast<int>(over.sizes().x()) + 1,
                       static_cast<int>(over.sizes().y()) + 1});
  cover_part(part, projected);
  mask_picture_.finish_shares(cells, rgba);
}

void ShadowPass::prepare(const Scene& scene, const FramePlan& plan, ShadowWork& work) {
  ++frame_count_;
  items_.clear();
  flats_.clear();
  if (!plan.reuse) {
    prepared_.clear();
    flat_prepared_.clear();
    plane_masks_.clear();
  }
  std::erase_if(flat_prepared_, [this](const auto& entry) {
    return entry.second.last_used + kFramesKept < frame_count_;
  });
  for (auto& [plane, mask] : plane_masks_) mask.in_use = false;
  for (const PlaneReceiver& receiver : plan.receivers) {
    const std::optional<double> depth = mask_depth(scene, plan, receiver.plane, work);
    if (!depth) continue;
    PlaneMask& mask = plane_masks_[receiver.plane];
    mask.in_use = true;
    mask.depth = *depth;
  }
  std::map<std::tuple<int, int, int>, int> repeats;
  for (const ShadowDraw& draw : plan.shadows) {
    Caster& caster = caster_of(scene, draw);
    const auto mask = plane_masks_.find(draw.plane);
    const bool masked = mask != plane_masks_.end() && mask->second.in_use;
    const int repeat = repeats[{draw.node, draw.object, draw.plane}]++;
    Prepared& prepared = prepared_[{draw.node, draw.object, draw.plane, repeat}];
    if (caster.whole.geometry.indices.empty()) {
      prepared.layers = {};
      prepared.valid = false;
    } else {
      prepare_one(draw, caster, prepared, masked, work);
      if (!masked) prepared.surface = surface_for(draw, plan, caster, prepared);
      note_empty_field(scene, draw, caster, prepared, work);
      for (const LayerGeometry& layer : prepared.layers) {
        if (!prepared.reduced || layer.source == LayerSource::nothing) continue;
        work.proxy_faces_saved += static_cast<std::int64_t>(
            (caster.whole.geometry.indices.size() - caster.reduced.geometry.indices.size()) / 3);
      }
    }
    items_.push_back({&caster, &prepared, draw.node, draw.object, draw.plane, draw.plane_frame});
  }
  for (auto& [plane, mask] : plane_masks_) {
    if (mask.in_use) make_mask(scene, plan, plane, mask, work);
  }
}

std::vector<ShadowPass::PartCover>::iterator ShadowPass::PlaneMask::cover_of(const MaskPart& part,
                                                                             double cell) {
  return std::ranges::find_if(covers, [&](const PartCover& known) {
    return known.cell == cell && known.part.covers_same_as(part);
  });
}

bool ShadowPass::MaskPart::covers_same_as(const MaskPart& other) const {
  return caster == other.caster && kernels == other.kernels && reduced == other.reduced &&
         own.same_shape(other.own) && own.T_plane_own == other.own.T_plane_own &&
         constants == other.constants && light_mode == other.light_mode && layers == other.layers &&
         faces == other.faces && sides == other.sides;
}

// What a mask has for each layer: what it leaves of the encoded value; through a screen-door, the
// share of places that it leaves open, of which 8 bits tell the number exactly.
glm::vec3 ShadowPass::mask_light(const ShadowDraw& draw) const {
  const glm::vec3 light = layer_light(draw);
  if (way_ != Translucency::mesh) return light;
  const auto open = [](float left) {
    return 1.0F - door_places(left) / static_cast<float>(kDoorPlaces);
  };
  return {open(light.x), open(light.y), open(light.z)};
}

bool ShadowPass::is_for_masks(Body& body, const ShadowMesh& mesh) {
  if (!body.edges_made) {
    body.edges = paired_edges(mesh.indices);
    if (!body.edges) body.oriented = oriented_faces(mesh.positions, mesh.indices);
    body.edges_made = true;
  }
  return body.edges || body.oriented;
}

// How near the nearest of a plane's shadows is, if all of them can be in a mask [m]; where nothing
// casts one, or they can't, nothing. A mask takes less than drawing its casters directly, be it 12
// faces or 23,000, and has smooth edges (BENCHMARKS.md); where casters of few faces are cut by the
// plane or at the height where the umbra ends it takes slightly more, and has these edges too. What
// is out of sight counts like the rest: else a shadow would be drawn another way when another one
// leaves the view. All of a plane or nothing: where they overlap the darkest layer counts, and
// once.
std::optional<double> ShadowPass::mask_depth(const Scene& scene, const FramePlan& plan, int plane,
                                             ShadowWork& work) {
  if (plan.layers == LayerDrawing::direct) return std::nullopt;
  if (way_ == Translucency::geometry_mesh) return std::nullopt;  // marked in the stencil
  const auto T_camera_table = plan.T_table_camera.inverse();
  constexpr double kNone = std::numeric_limits<double>::infinity();
  double in_view = kNone;
  double anywhere = kNone;
  std::size_t faces = 0;
  bool layers = false;
  bool fields = false;
  std::string why_not;
  const auto serves = [&](const ShadowDraw& draw) {
    const SceneObject& object = scene.objects[static_cast<std::size_t>(draw.object)];
    const bool field = draw.technique == ShadowTechnique::field;
    fields = fields || field;
    layers = layers || draw.technique != ShadowTechnique::simple;
    Caster& caster = caster_of(scene, draw);
    faces += caster.mesh.indices.size() / 3;
    if (caster.whole.geometry.indices.empty()) return true;
    if (!field &&
        (!is_for_masks(caster.whole, caster.mesh) ||
         (caster.proxy && draw.proxy && !is_for_masks(caster.reduced, caster.proxy->mesh)))) {
      why_not = fmt::format("it can't be told which way {}'s faces turn", object.name);
      return false;
    }
    const bool one_size = field || draw.light_mode == LightMode::fixed;
    if (!one_size && cut_layers(draw, caster) == std::array<LayerSource, 3>{}) return true;
    std::array<Eigen::Vector3d, 4> square = draw.plane_frame.square_about(draw.centre, draw.radius);
    for (Eigen::Vector3d& corner : square) corner = T_camera_table * corner;
    double nearest = kNone;
    for (const Eigen::Vector3d& corner : square) nearest = std::min(nearest, corner.z());
    anywhere = std::min(anywhere, nearest);
    if (!draw.off_outline && !frustum_.misses(square)) in_view = std::min(in_view, nearest);
    return true;
  };
  bool serve = true;
  for (const std::vector<ShadowDraw>* draws : {&plan.shadows, &plan.unseen_shadows}) {
    for (const ShadowDraw& draw : *draws) {
      if (draw.plane == plane && !serves(draw)) serve = false;
    }
  }
  // What is alone with others of its kind is what layers are compared with, and one draw call.
  if (!layers && plan.layers == LayerDrawing::automatic) return std::nullopt;
  if (!serve) {
    work.skipped.push_back(
        {"mask_impossible",
         fmt::format("{}: layers are drawn directly and not as a mask, for {}",
                     scene.planes[static_cast<std::size_t>(plane)].name, why_not)});
    return std::nullopt;
  }
  // A field has no edges that several samples a pixel would smooth.
  if (plan.layers == LayerDrawing::automatic && smooth_edges_ && faces <= kFewFaces && !fields)
    return std::nullopt;
  if (anywhere == kNone) return std::nullopt;
  return in_view == kNone ? anywhere : in_view;
}

ShadowPass::MaskPart ShadowPass::mask_part(const ShadowDraw& draw, Caster& caster,
                                           const Prepared& prepared) const {
  MaskPart part;
  part.caster = &caster;
  part.kernels = prepared.kernel_key;
  part.reduced = prepared.reduced;
  part.own = prepared.own;
  part.light = mask_light(draw);
  if (draw.technique == ShadowTechnique::simple) {
    part.constants = zenith_of_simple();
  } else {
    part.constants = draw.constants;
    part.light_mode = draw.light_mode;
  }
  if (draw.technique == ShadowTechnique::field) part.outlines = prepared.outlines;
  for (std::size_t layer = 0; layer < 3; ++layer) {
    const LayerSource source = prepared.layers[layer].source;
    part.layers[layer] = source == LayerSource::masked;
    part.faces[layer] = source == LayerSource::masked_faces;
    part.sides[layer] = source == LayerSource::masked_outline;
  }
  return part;
}

void ShadowPass::make_mask(const Scene& scene, const FramePlan& plan, int plane, PlaneMask& mask,
                           ShadowWork& work) {
  const auto T_camera_table = plan.T_table_camera.inverse();
  std::vector<MaskPart> parts;
  for (std::size_t i = 0; i < plan.shadows.size(); ++i) {
    const ShadowDraw& draw = plan.shadows[i];
    const Prepared& prepared = *items_[i].prepared;
    if (draw.plane != plane || !prepared.valid) continue;
    std::array<Eigen::Vector3d, 4> square = draw.plane_frame.square_about(draw.centre, draw.radius);
    for (Eigen::Vector3d& corner : square) corner = T_camera_table * corner;
    // What is out of sight is left out whatever the plan says: it would make the mask larger.
    // Kernels from a file may lie anywhere.
    if (draw.off_outline || (!prepared.kernel_key.stored && frustum_.misses(square))) continue;
    const MaskPart part = mask_part(draw, *items_[i].caster, prepared);
    if (!part.covers_nothing()) parts.push_back(part);
  }
  // By half powers of two, so that a camera that moves seldom makes another mask. Of the present
  // frame alone; but where a camera at rest trembles between two sizes, both are kept.
  const int half_octave = mask_cell_at(mask.depth, kPixelsPerMaskCell);
  const LayOut lay_out = [&](std::span<const CellBox> bounds) {
    const auto receiver = std::ranges::find(plan.receivers, plane, &PlaneReceiver::plane);
    const PlaneFrame& frame = receiver->frame;
    return lay_out_masks(bounds, half_octave, most_mask_side_, [&](const Eigen::AlignedBox2d& box) {
      std::array<Eigen::Vector3d, 4> corners = {
          frame.lift(box.min().x(), box.min().y()), frame.lift(box.max().x(), box.min().y()),
          frame.lift(box.max().x(), box.max().y()), frame.lift(box.min().x(), box.max().y())};
      for (Eigen::Vector3d& corner : corners) corner = T_camera_table * corner;
      SeenPart part;
      double nearest = std::numeric_limits<double>::infinity();
      for (const Eigen::Vector3d& corner : frustum_.part_in_view(corners)) {
        nearest = std::min(nearest, corner.z());
        part.box.extend(frame.to_plane(plan.T_table_camera * corner).head<2>());
      }
      if (!part.box.isEmpty()) part.half_octave = mask_cell_at(nearest, kPixelsPerSeenCell);
      return part;
    });
  };
  const auto is_it = [&](const DrawnMasks& masks) {
    return masks.made && masks.half_octave == half_octave &&
           std::ranges::equal(masks.parts, parts, &MaskPart::same_as) &&
           (!masks.layout.of_view || masks.layout == lay_out(masks.bounds));
  };
  if (!is_it(mask.now)) std::swap(mask.now, mask.other);
  const std::int64_t kept_before = work.layer_masks_kept;
  if (is_it(mask.now)) {
    work.layer_masks_kept += static_cast<std::int64_t>(mask.now.masks.size());
  } else {
    draw_masks(half_octave, std::move(parts), lay_out, mask, work);
  }
  if (work.layer_masks_kept > kept_before) {
    work.kept.push_back(
        {"layer_mask", fmt::format("{}: its mask is that of an earlier picture",
                                   scene.planes[static_cast<std::size_t>(plane)].name)});
  }
}

int ShadowPass::mask_cell_at(double depth, double pixels) const {
  return static_cast<int>(std::floor(
      2.0 * std::log2(pixels * pixel_at_unit_depth_ * std::max(depth, kNearestDistance))));
}

// What covers the layers that are covered face by face; in the own frame.
std::array<std::vector<PlanePoint>, 3> ShadowPass::face_images(const MaskPart& part,
                                                               ShadowWork& work) {
  std::array<std::vector<PlanePoint>, 3> images;
  if (part.faces == std::array<bool, 3>{}) return images;
  Caster& caster = *part.caster;
  KernelSet& set = caster.sets.at(part.kernels);
  const ShadowMesh& mesh = part.reduced ? caster.proxy->mesh : caster.mesh;
  const Body& body = part.reduced ? caster.reduced : caster.whole;
  const std::vector<std::uint32_t>& faces = body.oriented ? *body.oriented : mesh.indices;
  const std::vector<glm::vec3>& kernels = (part.reduced ? set.reduced : set.whole).kernels;
  std::vector<CasterVertex> vertices = own_vertices(
      part.own, mesh.positions, std::span<const glm::vec3>(kernels).first(mesh.positions.size()));
  for (CasterVertex& vertex : vertices) vertex.h = at_contact(vertex.h);
  work.vertices += static_cast<std::int64_t>(vertices.size());
  std::vector<VertexDisc> discs;
  if (part.light_mode == LightMode::fixed) {
    complete_set(caster, set, work);
    const std::vector<PartDisc>& parts = parts_of(caster, part.kernels.direction, false, work);
    discs = part.reduced ? vertex_discs(mesh, carried_kernels(*caster.proxy, set.made), parts,
                                        part.own.T_own_object.scale)
                         : vertex_discs(mesh, set.made, parts, part.own.T_own_object.scale);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    if (!part.faces[i]) continue;
    images[i] =
        part.light_mode == LightMode::fixed
            ? fixed_light_triangles(vertices, discs, faces, part.constants, kShadowLayers[i])
            : layer_triangles(vertices, faces, part.constants, kShadowLayers[i]);
  }
  return images;
}

void ShadowPass::project_part(const MaskPart& part,
                              const std::array<std::vector<PlanePoint>, 3>& faces, double cell,
                              MaskCaster& caster, ShadowWork& work) {
  if (part.layers == std::array<bool, 3>{}) {
    caster.begin(part.own, cell);
  } else {
    const KernelSet& set = part.caster->sets.at(part.kernels);
    const std::vector<glm::vec3>& positions =
        (part.reduced ? part.caster->proxy->mesh : part.caster->mesh).positions;
    caster.project(positions, (part.reduced ? set.reduced : set.whole).kernels, part.own,
                   part.constants, part.layers, cell);
    work.vertices += static_cast<std::int64_t>(positions.size());
  }
  for (std::size_t layer = 0; layer < 3; ++layer) {
    caster.project_faces(kShadowLayers[layer], faces[layer]);
    if (part.sides[layer]) caster.project_outline(kShadowLayers[layer], (*part.outlines)[layer]);
  }
}

void ShadowPass::cover_part(const MaskPart& part, MaskCaster& caster) {
  static const std::vector<FacePair> kNoEdges;
  const ShadowMesh& mesh = part.reduced ? part.caster->proxy->mesh : part.caster->mesh;
  const Body& body = part.reduced ? part.caster->reduced : part.caster->whole;
  if (part.layers == std::array<bool, 3>{}) {
    mask_picture_.cover(caster, {}, kNoEdges);
  } else {
    mask_picture_.cover(caster, mesh.indices, *body.edges);
  }
}

void ShadowPass::draw_masks(int half_octave, std::vector<MaskPart> of, const LayOut& lay_out,
                            PlaneMask& plane_mask, ShadowWork& work) {
  DrawnMasks older = std::move(plane_mask.now);
  DrawnMasks& made = plane_mask.now = {};
  made.made = true;
  made.parts = std::move(of);
  made.half_octave = half_octave;
  const std::vector<MaskPart>& parts = made.parts;
  ++plane_mask.times_drawn;
  if (mask_casters_.size() < parts.size()) mask_casters_.resize(parts.size());
  // Worth noting down is what has rested since the masks before, while others moved.
  std::vector<bool> rests(parts.size(), false);
  for (std::size_t i = 0; parts.size() > 1 && i < parts.size(); ++i) {
    rests[i] = std::ranges::any_of(plane_mask.drawn_before, [&](const MaskPart& before) {
      return before.covers_same_as(parts[i]);
    });
  }
  plane_mask.drawn_before = parts;

  std::vector<std::optional<std::array<std::vector<PlanePoint>, 3>>> faces(parts.size());
  std::vector<double> projected(parts.size(), 0.0);  // for cells of this size
  const auto project = [&](std::size_t i, double cell) {
    if (projected[i] == cell) return;
    if (!faces[i]) faces[i] = face_images(parts[i], work);
    project_part(parts[i], *faces[i], cell, mask_casters_[i], work);
    projected[i] = cell;
  };
  for (std::size_t i = 0; i < parts.size(); ++i) {
    const CellBox* known = nullptr;
    for (const DrawnMasks* before : {&older, &plane_mask.other}) {
      if (!rests[i] || !before->made || before->half_octave != half_octave) continue;
      for (std::size_t k = 0; k < before->parts.size() && known == nullptr; ++k) {
        if (before->parts[k].covers_same_as(parts[i])) known = &before->bounds[k];
      }
    }
    if (known == nullptr) project(i, cell_size(half_octave));
    made.bounds.push_back(known != nullptr ? *known : mask_casters_[i].bounds());
  }

  made.layout = lay_out(made.bounds);
  for (const MaskLayout::Group& group : made.layout.groups) {
    std::vector<MaskPart> of_group;
    for (const std::size_t i : group.parts) of_group.push_back(parts[i]);
    std::shared_ptr<DrawnMask> mask;
    for (const DrawnMasks* before : {&older, &plane_mask.other}) {
      const auto shows_it = [&](const std::shared_ptr<DrawnMask>& known) {
        return known->cells == group.cells &&
               std::ranges::equal(known->parts, of_group, &MaskPart::same_as);
      };
      const auto found = std::ranges::find_if(before->masks, shows_it);
      if (found == before->masks.end()) continue;
      mask = *found;
      break;
    }
    if (mask) {
      ++work.layer_masks_kept;
      made.masks.push_back(mask);
      continue;
    }
    const double cell = group.cells.size;
    std::vector<bool> noted(of_group.size(), false);
    for (std::size_t k = 0; k < of_group.size(); ++k) {
      const std::size_t i = group.parts[k];
      noted[k] = rests[i] && !group.cut && of_group.size() > 1;
      if (noted[k] && plane_mask.cover_of(parts[i], cell) != plane_mask.covers.end()) continue;
      project(i, cell);
      if (!noted[k]) continue;
      PartCover cover{parts[i], cell, {}, 0};
      const CellBox& bounds = mask_casters_[i].bounds();
      if (!bounds.isEmpty()) {
        mask_picture_.begin(cells_about(bounds, cell));
        cover_part(parts[i], mask_casters_[i]);
        mask_picture_.take(cover.cover);
      }
      plane_mask.covers.push_back(std::move(cover));
    }
    // Of those that nothing shows any more: a mask that changes need not be stored anew.
    for (std::shared_ptr<DrawnMask>& spare : older.masks) {
      if (spare.use_count() == 1 && !mask) mask = std::move(spare);
    }
    std::erase(older.masks, nullptr);
    if (!mask) mask = std::make_shared<DrawnMask>();
    mask->cells = group.cells;
    mask->parts = std::move(of_group);
    draw_mask(group, noted, plane_mask, *mask);
    made.masks.push_back(std::move(mask));
    ++work.layer_masks_drawn;
  }
  // Those of the last two masks: a camera may tremble between two sizes of cells.
  std::erase_if(plane_mask.covers, [&](const PartCover& cover) {
    return cover.last_used + 1 < plane_mask.times_drawn;
  });
}

void ShadowPass::draw_mask(const MaskLayout::Group& group, const std::vector<bool>& noted,
                           PlaneMask& plane_mask, DrawnMask& mask) {
  const MaskCells& cells = mask.cells;
  const std::vector<MaskPart>& parts = mask.parts;
  const auto width = static_cast<std::size_t>(cells.width);
  mask_codes_.resize(width * static_cast<std::size_t>(cells.height));
  // What is cut may be large: some rows at a time, lest sums of all take a lot of memory.
  const int rows =
      group.cut ? std::clamp(kMaskCellsAtOnce / cells.width, 1, cells.height) : cells.height;
  for (int first_row = 0; first_row < cells.height; first_row += rows) {
    MaskCells band = cells;
    band.v += first_row;
    band.height = std::min(rows, cells.height - first_row);
    const std::span<std::uint8_t> codes =
        std::span(mask_codes_)
            .subspan(width * static_cast<std::size_t>(first_row),
                     width * static_cast<std::size_t>(band.height));
    std::vector<bool> done(parts.size(), false);
    bool first = true;
    for (std::size_t of_light = 0; of_light < parts.size(); ++of_light) {
      if (done[of_light]) continue;
      const glm::vec3 light = parts[of_light].light;
      mask_picture_.begin(band);
      for (std::size_t k = of_light; k < parts.size(); ++k) {
        if (done[k] || parts[k].light != light) continue;
        done[k] = true;
        if (!noted[k]) {
          cover_part(parts[k], mask_casters_[group.parts[k]]);
          continue;
        }
        const auto known = plane_mask.cover_of(parts[k], cells.size);
        PENUMBRA_ASSERT(known != plane_mask.covers.end());
        known->last_used = plane_mask.times_drawn;
        mask_picture_.cover(known->cover);
      }
      if (first) {
        mask_picture_.finish(light, codes);
        first = false;
        continue;
      }
      // Where lights differ, the darkest.
      mask_picture_.finish(light, lighter_codes_);
      std::ranges::transform(codes, lighter_codes_, codes.begin(),
                             [](std::uint8_t a, std::uint8_t b) { return std::min(a, b); });
    }
  }
  mask.texture.upload(cells, mask_codes_);
}

std::vector<CasterKernels> ShadowPass::kernels_in_use() {
  std::vector<CasterKernels> in_use;
  for (const Item& item : items_) {
    const KernelKey& key = item.prepared->kernel_key;
    const auto found = item.caster->sets.find(key);
    if (!item.prepared->valid || !key.source || found == item.caster->sets.end()) continue;
    KernelSet& set = found->second;
    if (!set.spill) set.spill = layer_spill(item.caster->mesh, set.made, kGreatestFactor);
    CasterKernels& caster = in_use.emplace_back(
        CasterKernels{item.node, item.object, item.plane, set.twist, *set.spill, {}});
    const OwnFrame& own = item.prepared->own;
    std::set<std::array<float, 3>> seen;
    for (const glm::vec3& k : set.made.kernels) {
      if (!seen.insert({k.x, k.y, k.z}).second) continue;
      const Eigen::Vector2d p =
          own.T_plane_own *
          (own.T_own_object * Eigen::Vector3d(static_cast<double>(k.x), static_cast<double>(k.y),
                                              static_cast<double>(k.z)))
              .head<2>()
              .eval();
      const PlaneFrame& plane = item.plane_frame;
      caster.on_plane.emplace_back(plane.q + p.x() * plane.e1 + p.y() * plane.e2);
    }
  }
  return in_use;
}

Result<void> ShadowPass::choose(Translucency way, std::optional<PixelFormat> video) {
  way_ = way;
  fetches_video_ = video.has_value();
  if (way == Translucency::geometry_mesh) return {};  // layers are marked, not darkened
  if (auto chosen = shadow_program_.choose(way, video); !chosen) return chosen;
  if (auto chosen = mask_quad_.choose(way, video); !chosen) return chosen;
  return field_quad_.choose(way, video);
}

// For darkened_by_layer() of translucency.glsl.
glm::vec3 ShadowPass::layer_values(const ShadowDraw& draw, const Brush& brush) {
  const glm::vec3 light = layer_light(draw);
  if (!brush.door) return light;
  return {door_places(light.x), door_places(light.y), door_places(light.z)};
}

int ShadowPass::draw_layers(const ShadowDraw& draw, const Item& it, int first_layer, int count,
                            const Brush& brush) const {
  const LayerGeometry& layer = it.prepared->layers[static_cast<std::size_t>(first_layer)];
  if (layer.source == LayerSource::nothing) return 0;
  if (layer.source == LayerSource::field) return draw_field(draw, it, first_layer, count, brush);
  const ShaderProgram& p = brush.layers;
  p.use();
  const bool layered = draw.technique == ShadowTechnique::layered;
  // H = inf, or a simple shadow, has 1/H = 0; a simple shadow casts its middle layer at factor 1.
  const LayeredConstants& c = draw.constants;
  p.set("inverse_light_height", layered ? static_cast<float>(1.0 / c.light_height) : 0.0F);
  p.set("umbra_height", static_cast<float>(c.umbra_height));
  p.set("inverse_umbra_height", layered ? static_cast<float>(1.0 / c.umbra_height) : 0.0F);
  p.set("height_cap", static_cast<float>(std::min(range_of(draw, ShadowLayer::middle).high, 1e30)));
  p.set("layer_light", layer_values(draw, brush));
  p.set("first_layer", brush.penumbra_first ? first_layer + count - 1 : first_layer);
  p.set("layer_step", brush.penumbra_first ? -1 : 1);
  if (layer.source == LayerSource::whole) {
    p.set("plane_from_caster", plane_from_object(draw.plane_frame, draw.T_table_object));
    const auto set = it.caster->sets.find(it.prepared->kernel_key);
    PENUMBRA_ASSERT(set != it.caster->sets.end());
    const bool reduced = it.prepared->reduced;
    const Body& body = reduced ? it.caster->reduced : it.caster->whole;
    (reduced ? set->second.reduced : set->second.whole).layout.bind();
    const IndexRange& range = body.ranges[it.prepared->surface];
    glDrawElementsInstanced(GL_TRIANGLES, static_cast<GLsizei>(range.count), GL_UNSIGNED_INT,
                            reinterpret_cast<const void*>(range.first * sizeof(std::uint32_t)),
                            count);
  } else if (layer.source == LayerSource::placed) {
    PENUMBRA_ASSERT(count == 1);
    p.set("plane_from_caster", plane_from_own(it.prepared->own.T_plane_own));
    const Body& body = it.prepared->reduced ? it.caster->reduced : it.caster->whole;
    const IndexRange& range = body.ranges[it.prepared->surface];
    it.prepared->placed_layouts[static_cast<std::size_t>(first_layer)].bind();
    glDrawElementsInstanced(GL_TRIANGLES, static_cast<GLsizei>(range.count), GL_UNSIGNED_INT,
                            reinterpret_cast<const void*>(range.first * sizeof(std::uint32_t)), 1);
  } else {
    PENUMBRA_ASSERT(count == 1);
    if (layer.count == 0) return 0;
    p.set("plane_from_caster", plane_from_own(it.prepared->own.T_plane_own));
    it.prepared->clipped_layout.bind();
    glDrawArraysInstanced(GL_TRIANGLES, layer.first, layer.count, 1);
  }
  return 1;
}

int ShadowPass::draw_field(const ShadowDraw& draw, const Item& item, int first_layer, int count,
                           const Brush& brush) const {
  const Prepared& prepared = *item.prepared;
  std::array<bool, 3> wanted{};
  for (std::size_t i = 0; i < 3; ++i) {
    const auto layer = static_cast<int>(i);
    wanted[i] = prepared.wanted[i] && layer >= first_layer && layer < first_layer + count;
  }
  field_quad_.draw(brush.field, prepared.field, prepared.own.T_plane_own, wanted,
                   layer_values(draw, brush));
  return 1;
}

// All the layers that are whole and follow each other in one instanced draw: instances are drawn in
// order. Those of a field in one rectangle.
int ShadowPass::draw_all_layers(const ShadowDraw& draw, const Item& item,
                                const Brush& brush) const {
  const auto& layers = item.prepared->layers;
  const auto source = [&layers](int layer) {
    return layers[static_cast<std::size_t>(layer)].source;
  };
  struct Run {
    int first = 0, count = 0;
  };
  std::vector<Run> runs;
  for (int first = 0; first < 3; first += runs.back().count) {
    int count = 1;
    const bool together =
        source(first) == LayerSource::whole || source(first) == LayerSource::field;
    while (together && first + count < 3 && source(first + count) == source(first)) ++count;
    runs.push_back({first, count});
  }
  if (brush.penumbra_first) std::ranges::reverse(runs);
  int calls = 0;
  for (const Run& run : runs) calls += draw_layers(draw, item, run.first, run.count, brush);
  return calls;
}

int ShadowPass::draw_flat(std::size_t flat, int layer, const LensUniforms& camera,
                          const glm::mat4x3& camera_from_plane) {
  const auto& [draw, item] = flats_.at(flat);
  const Brush white{shadow_program_.plain(), field_quad_.program().plain()};
  begin_plane(white, camera, camera_from_plane);
  return draw_layers(draw, item, layer, 1, white);
}

void ShadowPass::begin_plane(const Brush& brush, const LensUniforms& lens,
                             const glm::mat4x3& camera_from_plane) {
  brush.layers.use();
  set_lens(brush.layers, lens);
  brush.layers.set("camera_from_plane", camera_from_plane);
  field_quad_.begin(brush.field, lens, camera_from_plane);
}

int ShadowPass::draw_plane(const FramePlan& plan, int plane, const Brush& brush) const {
  std::vector<std::size_t> casters;
  for (std::size_t i = 0; i < plan.shadows.size(); ++i) {
    if (plan.shadows[i].plane == plane) casters.push_back(i);
  }
  if (casters.size() == 1) {
    return draw_all_layers(plan.shadows[casters.front()], items_[casters.front()], brush);
  }
  // All umbrae, then all middles, then all penumbrae; where casters' lights differ, the darkest
  // first.
  struct Fill {
    std::size_t caster;
    int layer;
    float light;
  };
  std::vector<Fill> fills;
  for (int layer = 0; layer < 3; ++layer) {
    for (const std::size_t caster : casters)
      fills.push_back({caster, layer, layer_light(plan.shadows[caster])[layer]});
  }
  std::ranges::stable_sort(fills, {}, &Fill::light);
  if (brush.penumbra_first) std::ranges::reverse(fills);
  int calls = 0;
  for (const Fill& fill : fills)
    calls += draw_layers(plan.shadows[fill.caster], items_[fill.caster], fill.layer, 1, brush);
  return calls;
}

// The layers are marked in the stencil, each by how dark it is, the penumbra first; then strips are
// drawn over all pixels that are equally dark.
int ShadowPass::draw_strips(const FramePlan& plan, const PlaneReceiver& receiver,
                            const LensUniforms& lens, Receivers& receivers, const Brush& brush) {
  std::set<unsigned> levels;
  Eigen::AlignedBox2d bounds;
  int calls = 0;
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  for (int layer = 2; layer >= 0; --layer) {
    for (std::size_t i = plan.shadows.size(); i-- > 0;) {
      const ShadowDraw& draw = plan.shadows[i];
      if (draw.plane != receiver.plane) continue;
      const unsigned level = MeshStrips::level_of(layer_light(draw)[layer]);
      receivers.stencil_test(level, 0);
      const int drawn = draw_layers(draw, items_[i], layer, 1, brush);
      calls += drawn;
      if (drawn == 0) continue;
      levels.insert(level);
      const Eigen::Vector2d reach = Eigen::Vector2d::Constant(draw.radius);
      bounds.extend(Eigen::AlignedBox2d(draw.centre - reach, draw.centre + reach));
    }
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glStencilMask(0);
  glDisable(GL_DEPTH_TEST);
  const glm::mat4x3 to_camera = camera_from_plane(plan.T_table_camera, receiver.frame);
  for (const unsigned level : levels) {
    if (level == 0) continue;
    receivers.stencil_test(level, kShadowBits);
    calls += mesh_strips_.draw(level, bounds, lens, to_camera);
  }
  return calls;
}

int ShadowPass::draw(const FramePlan& plan, const LensUniforms& lens, Receivers& receivers,
                     const VideoPass& video, const Frame& frame, Framebuffer& framebuffer) {
  PENUMBRA_ASSERT(items_.size() == plan.shadows.size());
  mask_pieces_skipped_ = 0;
  const bool strips = way_ == Translucency::geometry_mesh;
  const Brush brush{strips ? shadow_program_.plain() : shadow_program_.get(),
                    strips ? field_quad_.program().plain() : field_quad_.program().get(),
                    way_ == Translucency::retexture, way_ == Translucency::mesh};
  int calls = 0;
  if (way_ == Translucency::retexture && !fetches_video_ && !plan.shadows.empty()) {
    framebuffer.copy_picture(kPictureBeforeUnit);  // no pixel is of two planes
  }
  for (const PlaneReceiver& receiver : plan.receivers) {
    const auto first = std::ranges::find(plan.shadows, receiver.plane, &ShadowDraw::plane);
    if (first == plan.shadows.end()) continue;
    receivers.begin_plane(plan, receiver.plane, receiver.frame, lens);
    begin_plane(brush, lens, camera_from_plane(plan.T_table_camera, receiver.frame));
    if (strips) {
      glDisable(GL_BLEND);
      calls += draw_strips(plan, receiver, lens, receivers, brush);
      continue;
    }
    if (way_ == Translucency::retexture) {
      for (const ShaderProgram* program : {&brush.field, &brush.layers, &mask_quad_.program()}) {
        program->use();
        if (fetches_video_) video.bind_texels(*program, frame, kVideoUnit);
        program->set("picture_before", kPictureBeforeUnit);
      }
    }
    begin_darkening(way_);
    const auto mask = plane_masks_.find(receiver.plane);
    if (mask != plane_masks_.end() && mask->second.in_use) {
      if (mask->second.now.masks.empty()) continue;
      glStencilMask(0);
      receivers.test_place();
      for (const std::shared_ptr<DrawnMask>& part : mask->second.now.masks) {
        mask_pieces_skipped_ += mask_quad_.draw(
            part->texture, lens, camera_from_plane(plan.T_table_camera, receiver.frame),
            {plan.whole_masks, plan.finest_edges});
        ++calls;
      }
      continue;
    }
    if (way_ == Translucency::blend) {
      // Each pixel once, with the layer that comes first.
      receivers.stencil_test(0, kShadowBits);
      glStencilOp(GL_KEEP, GL_KEEP, GL_INCR);
    } else {
      glStencilMask(0);
      receivers.test_place();
    }
    calls += draw_plane(plan, receiver.plane, brush);
  }
  glStencilMask(0xFF);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  glDepthMask(GL_TRUE);
  return calls;
}

}  // namespace penumbra
