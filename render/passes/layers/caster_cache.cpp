#include "render/passes/layers/caster_cache.hpp"

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <set>

#include "core/assert.hpp"
#include "render/camera_gl.hpp"
#include "render/model/cut_out.hpp"
#include "render/passes/object_painter.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/kernels/kernel_file.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMaxKernelSets = 64;  // per caster
constexpr std::size_t kMaxProxyChecks = 4096;
// Maximum ratio of the faces of a reduced mesh to the model's, both after splitting for the lens.
constexpr double kWorthwhileFaces = 0.75;
// Range of factors tested for twists: from an umbra that has almost vanished to a penumbra at 0.65
// of the umbra's height.
constexpr double kMinTestedFactor = 0.05;
constexpr double kMaxTestedFactor = 1.65;

// Returns, for each object, the maximum ratio of a shadow edge to the caster's edge: the penumbra's
// factor at the object's maximum height.
std::vector<double> largest_magnifications(const Scene& scene) {
  std::vector<double> magnifications(scene.objects.size(), 1.0);
  std::map<int, std::vector<double>> heights_over;  // by plane
  for (const ShadowNode& node : scene.shadows) {
    const HeightRange range = layer_height_range(node.layered, ShadowLayer::penumbra);
    for (const int plane : node.planes) {
      std::vector<double>& heights = heights_over[plane];
      if (heights.empty()) {
        const ScenePlane& at = scene.planes[static_cast<std::size_t>(plane)];
        heights = sphere_heights(scene, at.normal, at.point);
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

// Returns times at which to compare placements: keys, times between keys, and steps of a spin.
// Returns nullopt if there are too many.
std::optional<std::set<double>> sample_times(const Scene& scene) {
  constexpr std::size_t kMaxTimes = 20'000;
  constexpr int kSpinSteps = 8;
  std::set<double> times = {0.0};
  for (const SceneObject& object : scene.objects) {
    const std::vector<Keyframe>& keys = object.animation.keyframes;
    for (std::size_t i = 0; i < keys.size(); ++i) {
      times.insert(keys[i].time_s);
      if (i > 0) times.insert(0.5 * (keys[i].time_s + keys[i - 1].time_s));
    }
    if (times.size() > kMaxTimes) return std::nullopt;
    const double rate = std::abs(object.animation.spin_turns_per_s);
    for (int i = 1; rate > 0.0 && i < kSpinSteps; ++i) times.insert(i / (kSpinSteps * rate));
  }
  return times;
}

// Returns true if a shape of the object may have cut-outs.
bool may_have_cut_outs(const SceneObject& object) {
  if (!object.playback.model) return has_cut_outs(*object.model);
  return std::ranges::any_of(object.model->materials, [](const Material& material) {
    return material.alpha_mode != AlphaMode::opaque;
  });
}

// Returns the tag group of the object's root.
const std::string& tag_group_of(const Scene& scene, int object) {
  const SceneObject* at = &scene.objects[static_cast<std::size_t>(object)];
  while (at->parent >= 0) at = &scene.objects[static_cast<std::size_t>(at->parent)];
  return at->tag_group;
}

// Returns, for each object, whether its scale and tilt are constant. Only then a proxy pays off, as
// the comparison for each new tilt costs more than many frames save. Tag groups may tilt relative
// to each other.
std::vector<bool> steady_casters(const Scene& scene) {
  std::vector<bool> steady(scene.objects.size(), true);
  std::set<std::pair<int, int>> shadows;  // caster, plane
  for (const ShadowNode& node : scene.shadows) {
    for (const int plane : node.planes) {
      for (const int caster : node.casters) shadows.emplace(caster, plane);
    }
  }
  const auto plane_at = [&scene](int plane) -> const ScenePlane& {
    return scene.planes[static_cast<std::size_t>(plane)];
  };
  for (const auto& [caster, plane] : shadows) {
    if (tag_group_of(scene, caster) != plane_at(plane).tag_group)
      steady[static_cast<std::size_t>(caster)] = false;
  }
  const SceneState start = evaluate_scene(scene, 0.0);
  const std::optional<std::set<double>> times = sample_times(scene);
  if (!times) return std::vector<bool>(scene.objects.size(), false);
  for (const double time : *times) {
    const SceneState state = evaluate_scene(scene, time);
    for (const auto& [caster, plane] : shadows) {
      const auto tilt = [&up = plane_at(plane).normal](const Placement& placement) {
        return KernelDirection::nearest(placement.rotation.conjugate() * up);
      };
      const auto i = static_cast<std::size_t>(caster);
      const Placement& now = state.objects[i];
      const Placement& before = start.objects[i];
      steady[i] = steady[i] && now.scale == before.scale && tilt(now) == tilt(before);
    }
  }
  return steady;
}

void set_geometry(CasterBody& body, const ShadowMesh& mesh, float max_edge) {
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

// Adds the radii of generated kernels to kernels from a file, which have none.
void complete_set(CachedCaster& caster, KernelSet& set, RenderWork& work) {
  if (add_missing_radii(set.made, caster.mesh, set.made.up)) ++work[Counter::kernel_generations];
}

// Computes the body's kernels and uploads its faces and, if `to_gpu`, its vertices.
void write_vertices(CachedCaster& caster, KernelSet& set, bool reduced, bool to_gpu) {
  BodyVertices& vertices = reduced ? set.reduced : set.whole;
  CasterBody& body = reduced ? caster.reduced : caster.whole;
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
  VertexArray::attributes({3, 3});
  body.indices.bind();
}

bool has_edges_or_orientation(CasterBody& body, const ShadowMesh& mesh) {
  if (!body.edges_made) {
    body.edges = paired_edges(mesh.indices);
    if (!body.edges) body.oriented = oriented_faces(mesh.positions, mesh.indices);
    body.edges_made = true;
  }
  return body.edges || body.oriented;
}

}  // namespace

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

CasterCache::CasterCache(const Scene& scene, const CameraModel& camera)
    : edges_(longest_caster_edges(scene, camera)), steady_(steady_casters(scene)) {
  for (const SceneObject& object : scene.objects) {
    cut_outs_.push_back(object.model && may_have_cut_outs(object));
  }
}

CasterCache::Animated& CasterCache::animated(const Scene& scene, int object) {
  const auto known = animated_.find(object);
  if (known != animated_.end()) return known->second;
  const SceneObject& shown = scene.objects[static_cast<std::size_t>(object)];
  return animated_.emplace(object, Animated{{shown.playback.model, shown.groups}}).first->second;
}

// Returns true if the object still has its first tilt. The user can tilt it.
bool CasterCache::has_first_tilt(Animated& caster, const ShadowDraw& draw,
                                 const KernelDirection& direction) {
  return caster.directions.try_emplace(draw.plane, direction).first->second == direction;
}

bool CasterCache::carries_kernels(const Scene& scene, const ShadowDraw& draw) {
  const auto index = static_cast<std::size_t>(draw.object);
  // A new tilt would need new kernels and comparisons. Kernels ignore cut-outs.
  if (!steady_[index] || cut_outs_[index]) return false;
  Animated& from = animated(scene, draw.object);
  AnimatedCaster& caster = from.caster;
  if (!caster.mesh_of(*scene.objects[index].model)) return false;
  const Eigen::Vector3d up = draw.T_table_object.rotation.conjugate() * draw.plane_frame.n;
  const KernelDirection direction = KernelDirection::nearest(up);
  if (!has_first_tilt(from, draw, direction)) return false;
  // In half octaves, so that not every change of the light is compared again.
  const double octaves = std::log2(draw.constants.umbra_height / draw.T_table_object.scale);
  return caster.suits({direction, draw.kernels},
                      {draw.light_mode, std::exp2(0.5 * std::round(2.0 * octaves))});
}

// Moves the mesh of an animated object to its shape. Returns false if the shape has another mesh.
bool CasterCache::set_shape(const Scene& scene, int object, CachedCaster& entry) {
  Animated& from = animated(scene, object);
  std::optional<ShadowMesh> mesh = from.caster.mesh_of(*entry.model);
  if (!mesh) return false;
  entry.carrier = &from.caster;
  entry.mesh = std::move(*mesh);
  if (!from.edges_made) from.edges = paired_edges(entry.mesh.indices);
  from.edges_made = true;
  entry.whole.edges = from.edges;
  entry.whole.edges_made = from.edges.has_value();
  return true;
}

CachedCaster& CasterCache::caster_of(const Scene& scene, const ShadowDraw& draw) {
  const auto index = static_cast<std::size_t>(draw.object);
  const SceneObject& object = scene.objects[index];
  const float edge = edges_[index];
  const CutOuts cut_outs = cut_outs_[index] && !traits_of(draw.technique).ignores_cut_outs
                               ? CutOuts::visible_regions
                               : CutOuts::whole_faces;
  const bool rigid = object.playback.model == nullptr;
  auto& entry = casters_[{rigid ? object.model.get() : nullptr, edge, object.proxy_model.get(),
                          object.groups, cut_outs, rigid ? -1 : draw.object}];
  if (!entry) entry = std::make_unique<CachedCaster>();
  if (entry->model == object.model) return *entry;
  // Keeps the address, which other frames compare.
  *entry = CachedCaster();
  entry->model = object.model;
  // Cut-outs are made for each shape.
  if (rigid || cut_outs != CutOuts::whole_faces || !set_shape(scene, draw.object, *entry))
    entry->mesh = make_shadow_mesh(*object.model, object.groups, cut_outs);
  entry->stored_source = stored_kernel_source(*object.model);
  set_geometry(entry->whole, entry->mesh, edge);
  if (cut_outs == CutOuts::whole_faces && object.proxy_model) {
    entry->proxy = proxy_from_model(entry->mesh, *object.proxy_model);
    set_geometry(entry->reduced, entry->proxy->mesh, edge);
    const auto limit = kWorthwhileFaces * static_cast<double>(entry->whole.geometry.indices.size());
    const std::size_t faces = entry->reduced.geometry.indices.size();
    if (faces == 0 || static_cast<double>(faces) > limit) entry->proxy.reset();
  }
  if (!entry->mesh.positions.empty()) {
    entry->min_corner = entry->max_corner = entry->mesh.positions.front();
    for (const glm::vec3& p : entry->mesh.positions) {
      entry->min_corner = glm::min(entry->min_corner, p);
      entry->max_corner = glm::max(entry->max_corner, p);
      entry->size = std::max(entry->size, static_cast<double>(glm::length(p)));
    }
  }
  return *entry;
}

KernelSet& CasterCache::kernels_of(const ShadowDraw& draw, CachedCaster& caster,
                                   const KernelKey& key, RenderWork& work) {
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
  if (caster.carrier != nullptr) {
    const AnimatedCaster::Kernels by{key.direction, *key.source};
    int generated = 0;
    set.made = caster.carrier->kernels_at(by, draw.pose_s, caster.mesh.positions, generated);
    if (draw.light_mode == LightMode::fixed) {
      caster.part_sets[{key.direction, false}] =
          caster.carrier->parts_at(by, draw.pose_s, generated);
    }
    ++work[Counter::kernels_carried];
    work[Counter::kernel_generations] += generated;
  } else if (key.stored) {
    set.made = stored_kernels_of(caster.mesh);
  } else {
    set.made = generate_kernels(caster.mesh, key.direction.up(), *key.source);
    ++work[Counter::kernel_generations];
  }
  set.twist =
      find_twists(place_caster(caster.mesh, set.made, Placement(),
                               PlaneFrame::make(key.direction.up(), Eigen::Vector3d::Zero())),
                  caster.mesh.indices, kMinTestedFactor, kMaxTestedFactor);
  work[Counter::faces_tested] += static_cast<std::int64_t>(set.twist.faces_tested);
  work[Counter::faces_twisted] += static_cast<std::int64_t>(set.twist.faces_twisted);
  return set;
}

bool CasterCache::projects_on_cpu(const ShadowDraw& draw, const CasterBody& body) {
  return traits_of(draw.technique).uses_kernels &&
         (draw.light_mode == LightMode::fixed || !body.geometry.coarser.empty());
}

bool CasterCache::can_be_masked(const ShadowDraw& draw, CachedCaster& caster) {
  return traits_of(draw.technique).uses_outlines ||
         (has_edges_or_orientation(caster.whole, caster.mesh) &&
          (!caster.proxy || !draw.proxy ||
           has_edges_or_orientation(caster.reduced, caster.proxy->mesh)));
}

// The result depends on the tilt, not on earlier frames.
bool CasterCache::proxy_casts(const ShadowDraw& draw, CachedCaster& caster, const KernelKey& key,
                              KernelSet& set, RenderWork& work) {
  if (!caster.proxy || !draw.proxy || !traits_of(draw.technique).uses_kernels) return false;
  if (!steady_[static_cast<std::size_t>(draw.object)]) return false;
  const LayeredConstants& c = draw.constants;
  const CachedCaster::ProxyKey proxy_key{
      key,
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
  ++work[Counter::proxy_checks];
  const ProxyUse use{c, draw.light_mode, draw.T_table_object.scale};
  const bool is_sufficient =
      compare_with_proxy(caster.mesh, set.made, parts, *caster.proxy, use, false).is_sufficient();
  caster.proxy_kept.emplace(proxy_key, is_sufficient);
  return is_sufficient;
}

const std::vector<PartDisc>& CasterCache::field_parts_of(const ShadowDraw& draw,
                                                         CachedCaster& caster,
                                                         const KernelDirection& direction,
                                                         RenderWork& work) {
  const std::pair key(direction, true);
  // A new tilt would need new keys.
  if (caster.carrier != nullptr && !caster.part_sets.contains(key) &&
      steady_[static_cast<std::size_t>(draw.object)] &&
      has_first_tilt(animated_.at(draw.object), draw, direction)) {
    int generated = 0;
    auto parts = caster.carrier->field_parts_at(direction, draw.pose_s, caster.mesh, generated);
    work[Counter::kernel_generations] += generated;
    if (parts) return caster.part_sets.emplace(key, std::move(*parts)).first->second;
  }
  return parts_of(caster, direction, true, work);
}

const std::vector<PartDisc>& CasterCache::parts_of(CachedCaster& caster,
                                                   const KernelDirection& direction, bool of_field,
                                                   RenderWork& work) {
  const std::pair key(direction, of_field);
  const auto found = caster.part_sets.find(key);
  if (found != caster.part_sets.end()) return found->second;
  // Empties a full cache, as sets have only a few bytes per part.
  if (caster.part_sets.size() >= 4 * kMaxKernelSets) caster.part_sets.clear();
  ++work[Counter::kernel_generations];
  return caster.part_sets
      .emplace(key, part_discs(caster.mesh, direction.up(), kHalfFieldCell, !of_field))
      .first->second;
}

std::vector<VertexDisc> CasterCache::discs_of(CachedCaster& caster, const KernelKey& key,
                                              bool reduced, double scale, RenderWork& work) {
  KernelSet& set = caster.sets.at(key);
  complete_set(caster, set, work);
  const std::vector<PartDisc>& parts = parts_of(caster, key.direction, false, work);
  return reduced ? vertex_discs(caster.proxy->mesh, carried_kernels(*caster.proxy, set.made), parts,
                                scale)
                 : vertex_discs(caster.mesh, set.made, parts, scale);
}

CasterCache::Casting CasterCache::casting(const ShadowDraw& draw, CachedCaster& caster,
                                          const OwnFrame& own, bool to_gpu, RenderWork& work) {
  Casting with;
  if (traits_of(draw.technique).uses_kernels) {
    const bool may_be_stored =
        draw.kernels == KernelSource::automatic &&
        (draw.light_mode == LightMode::proportional || have_radii(caster.stored_source));
    with.key.source = may_be_stored ? caster.stored_source : draw.kernels;
    // Computed in the own frame, so that rotation in the plane changes no bit.
    const Eigen::Vector3d up = own.T_own_object.rotation.conjugate() * Eigen::Vector3d::UnitZ();
    with.key.direction = KernelDirection::nearest(up);
    // Compares the exact tilt, because KernelDirection may round it by up to 2 degrees.
    with.key.stored = may_be_stored && has_stored_kernels_for(caster.mesh, up);
  }
  if (traits_of(draw.technique).uses_outlines) return with;
  with.kernels = &kernels_of(draw, caster, with.key, work);
  with.reduced = proxy_casts(draw, caster, with.key, *with.kernels, work);
  const bool on_cpu = projects_on_cpu(draw, caster.body(with.reduced));
  write_vertices(caster, *with.kernels, with.reduced, to_gpu && !on_cpu);
  return with;
}

}  // namespace penumbra
