#include "render/passes/shadow_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <set>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "render/bounds.hpp"
#include "render/model/to_eigen.hpp"

namespace penumbra {
namespace {

// Factor for the overshoot in kernels_in_use(): a penumbra at 0.65 of the umbra's height.
constexpr double kOvershootFactor = 1.65;

// Reports a field in which all wanted layers are empty.
void note_empty_field(const ShadowDraw& draw, const CachedCaster& caster,
                      const PreparedShadow& prepared, RenderWork& work) {
  const auto is_empty = [](const LayerGeometry& layer) {
    return layer.source == LayerSource::nothing;
  };
  if (draw.technique != ShadowTechnique::field || !std::ranges::all_of(prepared.layers, is_empty) ||
      layer_sources(draw, caster) == LayerSources{})
    return;
  work.skipped.push_back({SkipReason::field_too_coarse, draw.object});
}

// Returns true if an object may be behind a plane, so that shadows are not only over video.
bool objects_lie_behind_planes(const Scene& scene, const FramePlan& plan) {
  constexpr double kContact = 1e-6;  // [m]
  for (const PlaneReceiver& receiver : plan.receivers) {
    if (std::ranges::find(plan.shadows, receiver.plane, &ShadowDraw::plane) == plan.shadows.end())
      continue;
    const double side = receiver.frame.height(plan.T_table_camera.translation()) < 0.0 ? -1.0 : 1.0;
    for (const ObjectDraw& object : plan.objects) {
      const auto& model = scene.objects[static_cast<std::size_t>(object.object)].model;
      if (!model) continue;
      for (const Eigen::Vector3d& corner : box_corners(*model, object.T_table_object)) {
        if (!(side * receiver.frame.height(corner) >= -kContact)) return true;
      }
    }
  }
  return false;
}

}  // namespace

Result<std::unique_ptr<ShadowPass>> ShadowPass::create(GlApi api, const CameraModel& camera,
                                                       const ShadowGeometry& geometry,
                                                       LayerPainter& painter, bool multisampled) {
  std::unique_ptr<ShadowPass> pass(new ShadowPass(camera, geometry, painter, multisampled));
  PENUMBRA_TRY(pass->mask_quad_, MaskQuad::create(api, longest_edge(camera)));
  PENUMBRA_TRY(pass->mesh_strips_, MeshStrips::create(api, camera));
  return pass;
}

Result<void> ShadowPass::choose(const DrawContext& context, const FramePlan& plan) {
  const Translucency mode = context.mode;
  std::optional<PixelFormat> video = context.video_format;
  if (mode == Translucency::retexture && objects_lie_behind_planes(context.scene, plan))
    video.reset();
  fetches_video_ = video.has_value();
  PENUMBRA_TRY_VOID(painter_.choose(mode, video));
  if (mode == Translucency::geometry_mesh) return {};
  return mask_quad_.choose(mode, video);
}

Result<void> ShadowPass::prepare(const DrawContext& context, const FramePlan& plan) {
  PENUMBRA_TRY_VOID(choose(context, plan));
  const Scene& scene = context.scene;
  RenderWork& work = context.work;
  CasterCache& casters = geometry_.casters();
  items_.clear();
  if (!plan.reuse) {
    prepared_.clear();
    masks_.clear();
  }
  masks_.plan(scene, plan, context.mode, casters, work);
  std::map<std::tuple<int, int, int>, int> repeats;
  for (const ShadowDraw& draw : plan.shadows) {
    CachedCaster& caster = casters.caster_of(scene, draw);
    const bool masked = masks_.has_mask(draw.plane);
    const int repeat = repeats[{draw.node, draw.object, draw.plane}]++;
    PreparedShadow& prepared = prepared_[{draw.node, draw.object, draw.plane, repeat}];
    if (caster.is_empty()) {
      prepared.clear();
    } else {
      geometry_.prepare(draw, caster, masked, prepared, work);
      if (!masked) prepared.surface = geometry_.coarsest_range(draw, plan, caster, prepared);
      note_empty_field(draw, caster, prepared, work);
      for (const LayerGeometry& layer : prepared.layers) {
        if (!prepared.key.reduced || layer.source == LayerSource::nothing) continue;
        work[Counter::proxy_faces_saved] += static_cast<std::int64_t>(
            (caster.whole.geometry.indices.size() - caster.reduced.geometry.indices.size()) / 3);
      }
    }
    items_.push_back({&caster, &prepared, draw.node, draw.object, draw.plane, draw.plane_frame});
  }
  masks_.make(plan, context.mode, items_, work);
  return {};
}

int ShadowPass::draw_plane(const FramePlan& plan, int plane,
                           const LayerPainter::Brush& brush) const {
  std::vector<std::size_t> casters;
  for (std::size_t i = 0; i < plan.shadows.size(); ++i) {
    if (plan.shadows[i].plane == plane) casters.push_back(i);
  }
  if (casters.size() == 1) {
    return painter_.draw_all(plan.shadows[casters.front()], items_[casters.front()], brush);
  }
  // Order: all umbrae, all middle layers, all penumbrae; if casters' fractions differ, darkest
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
    calls += painter_.draw(plan.shadows[fill.caster], items_[fill.caster], fill.layer, 1, brush);
  return calls;
}

// Writes the layers' levels of darkness into the stencil, the penumbra first; then draws strips
// over all pixels of each level.
int ShadowPass::draw_strips(const DrawContext& context, const FramePlan& plan,
                            const PlaneReceiver& receiver, const LayerPainter::Brush& brush) const {
  Receivers& receivers = context.receivers;
  std::set<unsigned> levels;
  Eigen::AlignedBox2d bounds;
  int calls = 0;
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  for (int layer = 2; layer >= 0; --layer) {
    for (std::size_t i = plan.shadows.size(); i-- > 0;) {
      const ShadowDraw& shadow = plan.shadows[i];
      if (shadow.plane != receiver.plane) continue;
      const unsigned level = MeshStrips::level_of(layer_light(shadow)[layer]);
      receivers.stencil_test(level, 0);
      const int drawn = painter_.draw(shadow, items_[i], layer, 1, brush);
      calls += drawn;
      if (drawn == 0) continue;
      levels.insert(level);
      const Eigen::Vector2d reach = Eigen::Vector2d::Constant(shadow.radius);
      bounds.extend(Eigen::AlignedBox2d(shadow.centre - reach, shadow.centre + reach));
    }
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glStencilMask(0);
  glDisable(GL_DEPTH_TEST);
  const glm::mat4x3 to_camera = camera_from_plane(plan.T_table_camera, receiver.frame);
  for (const unsigned level : levels) {
    if (level == 0) continue;
    receivers.stencil_test(level, kShadowBits);
    calls += mesh_strips_.draw(level, bounds, context.lens, to_camera);
  }
  return calls;
}

void ShadowPass::bind_background(const DrawContext& context,
                                 const LayerPainter::Brush& brush) const {
  for (const ShaderProgram* program : {&brush.field, &brush.layers, &mask_quad_.program()}) {
    program->use();
    if (fetches_video_) context.video.bind_texels(*program, context.frame, kVideoUnit);
  }
}

int ShadowPass::draw(const DrawContext& context, const FramePlan& plan) {
  PENUMBRA_ASSERT(items_.size() == plan.shadows.size());
  const auto& lens = context.lens;
  Receivers& receivers = context.receivers;
  const bool strips = context.mode == Translucency::geometry_mesh;
  const bool retextured = context.mode == Translucency::retexture;
  const LayerPainter::Brush brush = strips ? painter_.plain() : painter_.darkening();
  int calls = 0;
  if (retextured && !fetches_video_ && !plan.shadows.empty()) {
    context.framebuffer.copy_image(kFramebufferCopyUnit);  // once, as a pixel shows only one plane
  }
  for (const PlaneReceiver& receiver : plan.receivers) {
    const auto first = std::ranges::find(plan.shadows, receiver.plane, &ShadowDraw::plane);
    if (first == plan.shadows.end()) continue;
    receivers.begin_plane(plan, receiver.plane, receiver.frame, lens);
    painter_.begin_plane(brush, lens, camera_from_plane(plan.T_table_camera, receiver.frame));
    if (strips) {
      glDisable(GL_BLEND);
      calls += draw_strips(context, plan, receiver, brush);
      continue;
    }
    if (retextured) bind_background(context, brush);
    begin_translucent(context.mode, Blending::darken);
    const bool masked = masks_.has_mask(receiver.plane);
    if (masked && masks_.is_empty(receiver.plane)) continue;
    if (!masked && context.mode == Translucency::blend) {
      // Draws each pixel once, by the first layer.
      receivers.stencil_test(0, kShadowBits);
      glStencilOp(GL_KEEP, GL_KEEP, GL_INCR);
    } else {
      glStencilMask(0);
      receivers.test_plane();
    }
    calls += masked ? masks_.draw(plan, receiver, lens, mask_quad_, context.work)
                    : draw_plane(plan, receiver.plane, brush);
  }
  glStencilMask(0xFF);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  glDepthMask(GL_TRUE);
  return calls;
}

std::vector<CasterKernels> ShadowPass::kernels_in_use() {
  std::vector<CasterKernels> in_use;
  for (const ShadowItem& item : items_) {
    const KernelKey& key = item.prepared->key.kernels;
    const auto found = item.caster->sets.find(key);
    if (!item.prepared->valid || !key.source || found == item.caster->sets.end()) continue;
    KernelSet& set = found->second;
    if (!set.overshoot)
      set.overshoot = layer_overshoot(item.caster->mesh, set.made, kOvershootFactor);
    CasterKernels& caster = in_use.emplace_back(
        CasterKernels{item.node, item.object, item.plane, set.twist, *set.overshoot, {}});
    const OwnFrame& own = item.prepared->own;
    std::set<std::array<float, 3>> seen;
    for (const glm::vec3& k : set.made.kernels) {
      if (!seen.insert({k.x, k.y, k.z}).second) continue;
      const Eigen::Vector2d p = own.T_plane_own * (own.T_own_object * to_eigen(k)).head<2>().eval();
      const PlaneFrame& plane = item.plane_frame;
      caster.on_plane.emplace_back(plane.q + p.x() * plane.e1 + p.y() * plane.e2);
    }
  }
  return in_use;
}

}  // namespace penumbra
