#include "render/passes/layers/layer_painter.hpp"

#include <epoxy/gl.h>

#include <algorithm>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "render/passes/uniforms.hpp"

namespace penumbra {
namespace {

// (u, v, h) of the own frame -> (u, v, h) of the plane.
glm::mat4x3 plane_from_own(const PlanarMotion& T) {
  const auto c = static_cast<float>(T.cosine);
  const auto s = static_cast<float>(T.sine);
  return {glm::vec3(c, s, 0.0F), glm::vec3(-s, c, 0.0F), glm::vec3(0.0F, 0.0F, 1.0F),
          glm::vec3(static_cast<float>(T.displacement.x()), static_cast<float>(T.displacement.y()),
                    0.0F)};
}

// Returns each layer's argument of darkened_by_layer() in translucency.glsl.
glm::vec3 layer_values(const ShadowDraw& draw, const LayerPainter::Brush& brush) {
  const glm::vec3 light = layer_light(draw);
  if (!brush.door) return light;
  return {opaque_screen_door_pixels(light.x), opaque_screen_door_pixels(light.y),
          opaque_screen_door_pixels(light.z)};
}

void draw_range(const CasterBody::IndexRange& range, int instances) {
  glDrawElementsInstanced(GL_TRIANGLES, static_cast<GLsizei>(range.count), GL_UNSIGNED_INT,
                          reinterpret_cast<const void*>(range.first * sizeof(std::uint32_t)),
                          instances);
}

}  // namespace

Result<LayerPainter> LayerPainter::create(GlApi api, const CameraModel& camera) {
  LayerPainter painter;
  PENUMBRA_TRY(painter.program_,
               TranslucentProgram::create(api, {"lens.glsl", "shadow.vert.glsl"},
                                          {"shadow.frag.glsl"}, {}, Background::video));
  PENUMBRA_TRY(painter.field_quad_, FieldQuad::create(api, longest_edge(camera)));
  return painter;
}

Result<void> LayerPainter::choose(Translucency mode, std::optional<PixelFormat> video) {
  mode_ = mode;
  if (mode == Translucency::geometry_mesh) return {};  // layers are marked in the stencil instead
  PENUMBRA_TRY_VOID(program_.choose(mode, video));
  return field_quad_.choose(mode, video);
}

LayerPainter::Brush LayerPainter::darkening() const {
  return {program_.get(), field_quad_.program().get(), mode_ == Translucency::retexture,
          mode_ == Translucency::mesh};
}

LayerPainter::Brush LayerPainter::plain() const {
  return {program_.plain(), field_quad_.program().plain()};
}

void LayerPainter::begin_plane(const Brush& brush, const LensUniforms& lens,
                               const glm::mat4x3& camera_from_plane) {
  brush.layers.use();
  set_lens(brush.layers, lens);
  brush.layers.set("camera_from_plane", camera_from_plane);
  field_quad_.begin(brush.field, lens, camera_from_plane);
}

int LayerPainter::draw(const ShadowDraw& draw, const ShadowItem& item, int first_layer, int count,
                       const Brush& brush) const {
  const PreparedShadow& prepared = *item.prepared;
  const LayerGeometry& layer = prepared.layers[static_cast<std::size_t>(first_layer)];
  if (layer.source == LayerSource::nothing) return 0;
  if (layer.source == LayerSource::field) {
    std::array<bool, 3> wanted{};
    for (int i = first_layer; i < first_layer + count; ++i)
      wanted[static_cast<std::size_t>(i)] = prepared.wanted[static_cast<std::size_t>(i)];
    field_quad_.draw(brush.field, prepared.field, prepared.own.T_plane_own, wanted,
                     layer_values(draw, brush));
    return 1;
  }
  const ShaderProgram& p = brush.layers;
  p.use();
  const bool layered = traits_of(draw.technique).has_penumbra;
  // 1/H = 0 for H = inf and for a simple shadow, which is a middle layer at factor 1.
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
    item.caster->sets.at(prepared.key.kernels).vertices(prepared.key.reduced).layout.bind();
    draw_range(item.caster->body(prepared.key.reduced).ranges[prepared.surface], count);
    return 1;
  }
  PENUMBRA_ASSERT(count == 1);
  p.set("plane_from_caster", plane_from_own(prepared.own.T_plane_own));
  if (layer.source == LayerSource::placed) {
    prepared.placed_layouts[static_cast<std::size_t>(first_layer)].bind();
    draw_range(item.caster->body(prepared.key.reduced).ranges[prepared.surface], 1);
    return 1;
  }
  if (layer.count == 0) return 0;
  prepared.clipped.bind();
  glDrawArraysInstanced(GL_TRIANGLES, layer.first, layer.count, 1);
  return 1;
}

int LayerPainter::draw_all(const ShadowDraw& shadow, const ShadowItem& item,
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
  for (const Run& run : runs) calls += draw(shadow, item, run.first, run.count, brush);
  return calls;
}

}  // namespace penumbra
