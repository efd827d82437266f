#include "render/passes/layers/shadow_geometry.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/assert.hpp"
#include "render/bounds.hpp"
#include "render/model/to_eigen.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/fields/fixed_light.hpp"

namespace penumbra {
namespace {

// Heights this far outside a range count as within it [m], so that rounding does not clip a caster
// that stands on the plane.
constexpr double kContactTolerance = 1e-6;
// Bits of tilt and height in OwnFrame::make().
constexpr int kLayerBits = 26;  // as exact as floats
constexpr int kFieldBits = 13;  // errors of 1/32 cell

std::array<bool, 3> wanted_layers(const ShadowDraw& draw) {
  return {draw.umbra, draw.middle, draw.penumbra};
}

// Maps object points to heights above the plane: n . (position + R s p - q).
struct HeightMap {
  Eigen::Vector3d gradient;
  double offset;

  HeightMap(const PlaneFrame& plane, const Placement& T)
      : gradient(T.scale * (T.rotation.conjugate() * plane.n)), offset(plane.height(T.position)) {}
  [[nodiscard]] double operator()(const glm::vec3& p) const {
    return gradient.dot(to_eigen(p)) + offset;
  }
};

HeightRange heights_of(const HeightMap& height, std::span<const glm::vec3> points) {
  HeightRange range{std::numeric_limits<double>::infinity(),
                    -std::numeric_limits<double>::infinity()};
  for (const glm::vec3& p : points) {
    const double h = height(p);
    range.low = std::min(range.low, h);
    range.high = std::max(range.high, h);
  }
  return range;
}

bool within(const HeightRange& heights, const HeightRange& range) {
  return heights.low >= range.low - kContactTolerance &&
         heights.high <= range.high + kContactTolerance;
}
bool is_outside(const HeightRange& heights, const HeightRange& range) {
  return heights.high < range.low - kContactTolerance ||
         heights.low > range.high + kContactTolerance;
}

// Converts the fraction of light left into a factor on the encoded value: darkening linear light by
// k multiplies the encoded value by k^(1/exponent). The factor is 1 for an opacity of 0.
float encoded_factor(double light_fraction, double tone_exponent, float opacity) {
  const double factor = std::pow(std::clamp(light_fraction, 0.0, 1.0), 1.0 / tone_exponent);
  return static_cast<float>(1.0 - static_cast<double>(opacity) * (1.0 - factor));
}

void upload_placed(const std::array<std::vector<PlanePoint>, 3>& images, const CasterBody& body,
                   PreparedShadow& prepared) {
  std::vector<PlanePoint> all;
  all.reserve(3 * body.geometry.positions.size());
  std::array<std::size_t, 3> first{};
  for (std::size_t i = 0; i < 3; ++i) {
    first[i] = all.size();
    all.insert(all.end(), images[i].begin(), images[i].end());
  }
  prepared.placed.write(std::span<const PlanePoint>(all), BufferLife::every_frame);
  for (std::size_t i = 0; i < 3; ++i) {
    if (images[i].empty()) continue;
    // Position and kernel are the same point, so that the shader projects it onto itself.
    prepared.placed_layouts[i].bind();
    for (const unsigned attribute : {0U, 1U}) {
      VertexArray::attribute(attribute, 2, sizeof(PlanePoint), first[i] * sizeof(PlanePoint));
    }
    body.indices.bind();
  }
}

void clip_layers(const ShadowDraw& draw, const CachedCaster& caster, const KernelSet& kernels,
                 PreparedShadow& prepared, RenderWork& work) {
  const CasterBody& body = caster.body(prepared.key.reduced);
  const std::vector<CasterVertex> vertices = own_vertices(
      prepared.own, body.geometry.positions, kernels.vertices(prepared.key.reduced).kernels, work);
  std::vector<CasterVertex> clipped;
  for (std::size_t i = 0; i < 3; ++i) {
    LayerGeometry& layer = prepared.layers[i];
    if (layer.source != LayerSource::clipped) continue;
    const HeightRange range = range_of(draw, kShadowLayers[i]);
    // Middle layer and penumbra share the vertices if both are clipped at the same height.
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
  prepared.clipped.write(clipped, BufferLife::every_frame);
}

}  // namespace

glm::vec3 layer_light(const ShadowDraw& draw) {
  const auto factor = [&draw](double fraction) {
    return encoded_factor(fraction, draw.tone_exponent, draw.opacity);
  };
  return {factor(draw.fractions.umbra), factor(draw.fractions.middle),
          factor(draw.fractions.penumbra)};
}

LayeredConstants zenith_constants() {
  LayeredConstants constants;
  constants.light_height = std::numeric_limits<double>::infinity();
  constants.umbra_height = 1.0;
  return constants;
}

HeightRange range_of(const ShadowDraw& draw, ShadowLayer layer) {
  if (!traits_of(draw.technique).has_penumbra)
    return {0.0, std::numeric_limits<double>::infinity()};
  return layer_height_range(draw.constants, layer);
}

std::vector<CasterVertex> own_vertices(const OwnFrame& own, std::span<const glm::vec3> positions,
                                       std::span<const glm::vec3> kernels, RenderWork& work) {
  work[Counter::shadow_vertices] += static_cast<std::int64_t>(positions.size());
  const PlaneMap map = plane_map(own.T_own_object, PlaneFrame());
  std::vector<CasterVertex> vertices;
  vertices.reserve(positions.size());
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const Eigen::Vector3d x = map.linear * to_eigen(positions[i]) + map.offset;
    const Eigen::Vector3d k = map.linear * to_eigen(kernels[i]) + map.offset;
    vertices.push_back({static_cast<float>(x.x()), static_cast<float>(x.y()),
                        static_cast<float>(x.z()), static_cast<float>(k.x()),
                        static_cast<float>(k.y())});
  }
  return vertices;
}

void settle_contact(std::vector<CasterVertex>& vertices) {
  for (CasterVertex& vertex : vertices) {
    if (vertex.h < 0.0F && static_cast<double>(vertex.h) > -kContactTolerance) vertex.h = 0.0F;
  }
}

LayerSources layer_sources(const ShadowDraw& draw, const CachedCaster& caster) {
  const HeightMap height(draw.plane_frame, draw.T_table_object);
  // In most frames the box is sufficient.
  const glm::vec3& a = caster.min_corner;
  const glm::vec3& b = caster.max_corner;
  const HeightRange box = heights_of(height, std::array<glm::vec3, 8>{a,
                                                                      {b.x, a.y, a.z},
                                                                      {a.x, b.y, a.z},
                                                                      {b.x, b.y, a.z},
                                                                      {a.x, a.y, b.z},
                                                                      {b.x, a.y, b.z},
                                                                      {a.x, b.y, b.z},
                                                                      b});
  std::optional<HeightRange> exact;
  LayerSources sources{};
  const std::array<bool, 3> wanted = wanted_layers(draw);
  for (std::size_t i = 0; i < 3; ++i) {
    if (!wanted[i]) continue;
    const HeightRange range = range_of(draw, kShadowLayers[i]);
    HeightRange heights = box;
    if (!within(box, range)) {
      if (!exact) exact = heights_of(height, caster.mesh.positions);
      heights = *exact;
    }
    if (is_outside(heights, range)) continue;
    sources[i] = within(heights, range) ? LayerSource::whole : LayerSource::clipped;
  }
  return sources;
}

ShadowGeometry::ShadowGeometry(CasterCache& casters, const CameraModel& camera)
    : casters_(casters),
      edge_at_unit_depth_(longest_edge(camera) / kNearestDistance),
      longest_cut_edge_(camera.has_distortion()
                            ? static_cast<float>(edge_at_unit_depth_ * kNearestDistance)
                            : 0.0F),
      finest_field_cell_(kNearestDistance /
                         std::max(camera.parameters().fx, camera.parameters().fy)) {}

void ShadowGeometry::prepare(const ShadowDraw& draw, CachedCaster& caster, bool masked,
                             PreparedShadow& prepared, RenderWork& work) const {
  const bool field = draw.technique == ShadowTechnique::field;
  const OwnFrame own =
      OwnFrame::make(draw.T_table_object, draw.plane_frame, draw.T_table_object.scale * caster.size,
                     field ? kFieldBits : kLayerBits);
  const auto [kernel_key, kernels, reduced] = casters_.casting(draw, caster, own, !masked, work);
  if (reduced) ++work[Counter::proxy_shadows];
  const std::array<bool, 3> wanted = wanted_layers(draw);
  const ShadowKey key{draw.technique,
                      draw.light_mode,
                      traits_of(draw.technique).has_penumbra ? draw.constants : LayeredConstants(),
                      draw.pose_s,
                      field ? std::array<bool, 3>() : wanted,
                      reduced,
                      masked,
                      kernel_key};
  const bool reused = prepared.valid && prepared.key == key && prepared.own.same_shape(own);
  prepared.own = own;
  prepared.wanted = wanted;
  if (reused) {
    ++work[Counter::reprojections];
  } else {
    ++work[Counter::triples_recomputed];
    prepared.valid = true;
    prepared.key = key;
    prepared.magnification = 1.0;
    prepared.layers = {};
    prepared.outlines.reset();
    switch (draw.technique) {
      case ShadowTechnique::simple:
      case ShadowTechnique::layered:
        place_layers(draw, caster, *kernels, prepared, work);
        break;
      case ShadowTechnique::field:
        make_field(draw, caster, prepared, work);
        break;
      case ShadowTechnique::none:
      case ShadowTechnique::walls:
      case ShadowTechnique::hard:
      case ShadowTechnique::volume:
        PENUMBRA_ASSERT(false);  // these techniques have no ShadowDraw
    }
  }
  if (!field) return;
  for (std::size_t i = 0; i < 3; ++i) {
    prepared.layers[i].source = LayerSource::nothing;
    if (!prepared.wanted[i]) continue;
    if (masked && !(*prepared.outlines)[i].empty())
      prepared.layers[i].source = LayerSource::masked_outline;
    if (!masked && prepared.field.layers()[i]) prepared.layers[i].source = LayerSource::field;
  }
}

void ShadowGeometry::place_layers(const ShadowDraw& draw, CachedCaster& caster, KernelSet& kernels,
                                  PreparedShadow& prepared, RenderWork& work) const {
  const bool fixed = draw.light_mode == LightMode::fixed;
  if (fixed && !prepared.key.masked) {
    project_layers(draw, caster, kernels, prepared, work);
    return;
  }
  const CasterBody& body = caster.body(prepared.key.reduced);
  const LayerSources sources = layer_sources(draw, caster);
  bool clips = false;
  for (std::size_t i = 0; i < 3; ++i) {
    if (!prepared.wanted[i]) continue;
    prepared.layers[i].source = sources[i];
    clips = clips || sources[i] == LayerSource::clipped;
    if (!prepared.key.masked) continue;
    // A part's umbra vanishes at a height that layer_sources() does not know for a fixed light.
    if (sources[i] == LayerSource::nothing && !fixed) continue;
    const bool is_closed = sources[i] == LayerSource::whole && body.edges && !fixed;
    prepared.layers[i].source = is_closed ? LayerSource::masked : LayerSource::masked_faces;
  }
  if (prepared.key.masked) return;
  if (CasterCache::projects_on_cpu(draw, body)) {
    project_layers(draw, caster, kernels, prepared, work);
  } else if (clips) {
    clip_layers(draw, caster, kernels, prepared, work);
  }
}

// Projects on the CPU: for fixed lights, whose factor differs between vertices, and for casters
// whose edges are split for the lens. Splitting adds vertices on the straight edges of the
// projected faces (docs/shadows.md#layers).
void ShadowGeometry::project_layers(const ShadowDraw& draw, CachedCaster& caster,
                                    KernelSet& kernels, PreparedShadow& prepared,
                                    RenderWork& work) const {
  const bool fixed = draw.light_mode == LightMode::fixed;
  const CasterBody& body = caster.body(prepared.key.reduced);
  const ShadowMesh& mesh = caster.casting_mesh(prepared.key.reduced);
  const Placement& T_own_object = prepared.own.T_own_object;
  std::vector<CasterVertex> vertices = own_vertices(
      prepared.own, mesh.positions, caster.kernels(kernels, prepared.key.reduced), work);
  settle_contact(vertices);
  std::vector<VertexDisc> discs;
  if (fixed) {
    discs = CasterCache::discs_of(caster, prepared.key.kernels, prepared.key.reduced,
                                  T_own_object.scale, work);
  }
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
      for (const CasterBody::LongEdge& long_edge : body.long_edges) {
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
        longest_cut_edge_);
    if (faces.empty()) {
      layer.source = LayerSource::nothing;
      continue;
    }
    layer.source = LayerSource::clipped;
    layer.first = static_cast<int>(cut.size());
    layer.count = static_cast<int>(faces.size());
    for (const PlanePoint& p : faces) cut.push_back({p.u, p.v, 0.0F, p.u, p.v});
  }
  if (!cut.empty()) prepared.clipped.write(cut, BufferLife::every_frame);
  upload_placed(images, body, prepared);
}

void ShadowGeometry::make_field(const ShadowDraw& draw, CachedCaster& caster,
                                PreparedShadow& prepared, RenderWork& work) const {
  const Placement& T_own_object = prepared.own.T_own_object;
  const PlaneFrame plane;
  const Eigen::Vector3d up = T_own_object.rotation.conjugate() * plane.n;
  const KernelDirection direction = KernelDirection::nearest(up);
  const std::vector<PartDisc>& parts = casters_.field_parts_of(draw, caster, direction, work);
  const PlaneMap map = plane_map(T_own_object, plane);
  // The tolerance keeps rounding of tilt and height from clipping a caster on the plane.
  const auto contact = static_cast<float>(
      kContactTolerance + std::ldexp(T_own_object.scale * caster.size, 2 - kFieldBits));
  std::vector<CasterVertex> vertices;
  vertices.reserve(caster.mesh.positions.size());
  for (const glm::vec3& p : caster.mesh.positions) {
    const Eigen::Vector3f x = (map.linear * to_eigen(p) + map.offset).cast<float>();
    const float h = x.z() < 0.0F && x.z() > -contact ? 0.0F : x.z();
    vertices.push_back({x.x(), x.y(), h, x.x(), x.y()});
  }
  work[Counter::shadow_vertices] += static_cast<std::int64_t>(vertices.size());
  ShadowFieldOptions options;
  options.finest_cell = finest_field_cell_;
  const ShadowField field =
      power_distance_layers(vertices, caster.mesh.indices, caster.mesh.part,
                            part_lights(parts, T_own_object, plane), draw.constants, options);
  if (!prepared.key.masked) {
    prepared.field.upload(field);
    return;
  }
  FieldOutlines outlines;
  for (std::size_t i = 0; i < 3; ++i) outlines[i] = field_outline(field, kShadowLayers[i]);
  prepared.outlines = std::make_shared<const FieldOutlines>(std::move(outlines));
}

std::size_t ShadowGeometry::coarsest_range(const ShadowDraw& draw, const FramePlan& plan,
                                           const CachedCaster& caster,
                                           const PreparedShadow& prepared) const {
  const CasterBody& body = caster.body(prepared.key.reduced);
  const std::size_t finest = body.geometry.coarser.size();
  if (finest == 0) return finest;
  const BoxCorners corners = box_corners(caster.min_corner, caster.max_corner, draw.T_table_object);
  const Disc disc = footprint(corners, draw.plane_frame);
  const double top = std::max(heights_above(draw.plane_frame, corners).high, 0.0);
  double magnification = 1.0;
  if (traits_of(draw.technique).has_penumbra) {
    for (const ShadowLayer layer : {ShadowLayer::umbra, ShadowLayer::penumbra})
      magnification = std::max(magnification, layer_factor(draw.constants, layer, top));
  }
  // Kernels lie inside the footprint's disc, so this radius contains all projected points.
  const double radius = disc.radius * (1.05 * (2.0 * magnification - 1.0));
  const Eigen::Vector3d axis = plan.T_table_camera.rotation() * Eigen::Vector3d::UnitZ();
  const PlaneFrame& plane = draw.plane_frame;
  const Eigen::Vector3d middle = plane.lift(disc.centre.x(), disc.centre.y());
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

std::optional<ShadowReach> ShadowGeometry::reach_of(const Scene& scene, const ShadowDraw& draw,
                                                    double from, RenderWork& work) const {
  if (has_one_light_size(draw)) return std::nullopt;
  const bool layered = traits_of(draw.technique).has_penumbra;
  CachedCaster& caster = casters_.caster_of(scene, draw);
  ShadowReach reach;
  if (caster.is_empty()) return reach;
  const OwnFrame own = OwnFrame::make(draw.T_table_object, draw.plane_frame,
                                      draw.T_table_object.scale * caster.size, kLayerBits);
  const CasterCache::Casting casting = casters_.casting(draw, caster, own, false, work);
  const ShadowMesh& mesh = caster.casting_mesh(casting.reduced);
  const std::vector<CasterVertex> vertices =
      own_vertices(own, mesh.positions, caster.kernels(*casting.kernels, casting.reduced), work);
  // The projection of a clipped face lies between those of its vertices.
  std::vector<bool> casts(vertices.size(), false);
  const double min_height = from - kContactTolerance;
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    const std::array<std::uint32_t, 3> face = {mesh.indices[i], mesh.indices[i + 1],
                                               mesh.indices[i + 2]};
    const bool is_over = std::ranges::any_of(face, [&](std::uint32_t corner) {
      return static_cast<double>(vertices[corner].h) >= min_height;
    });
    if (!is_over) continue;
    for (const std::uint32_t corner : face) casts[corner] = true;
  }
  double top = 0.0;  // height above `from`
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
  double thickest = 0.0;  // maximum length of x - k
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    if (!casts[i]) continue;
    const CasterVertex& vertex = vertices[i];
    const auto h = static_cast<double>(vertex.h);
    reach.low = std::min(reach.low, h);
    reach.box.extend(image_at(vertex, 1.0));
    if (!layered) continue;
    thickest = std::max(
        thickest, static_cast<double>(std::hypot(vertex.u - vertex.ku, vertex.v - vertex.kv)));
    // Factors lie between 1 (at the lowest height, see above) and the factor at the vertex's
    // height. If faces are clipped at `highest`, the factor at `highest` bounds all factors.
    for (const ShadowLayer layer : kShadowLayers) {
      const double highest = layer_height_range(c, layer).high;
      const double height = top > highest ? highest : std::clamp(h - from, 0.0, highest);
      reach.box.extend(image_at(vertex, layer_factor(c, layer, height)));
    }
  }
  if (layered) reach.rate = thickest * layer_rate(c, ShadowLayer::penumbra, top);
  return reach;
}

}  // namespace penumbra
