#include "render/passes/received_shadow_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "render/bounds.hpp"
#include "render/passes/layers/plane_masks.hpp"

namespace penumbra {
namespace {

// Fewer than for other shadows: all levels are recomputed when the caster's height changes.
constexpr std::size_t kMaxFieldLevels = 16;
constexpr double kFinestTexel = 5e-4;  // [m]
constexpr int kMaxTexels = 1024;       // along a side
// Limits for one pair of caster and receiver, and for all pairs in caster_receiver_pairs.
constexpr double kMaxTexelsOfPair = 4e6;
constexpr double kMinTexelsOfPair = 1e5;
constexpr double kMaxTexelsOfFrame = 64e6;
constexpr double kMaxLevelStep = 0.03;  // [m]
constexpr int kTexelsAtOnce = 32;       // sides are multiples of this: storage changes rarely
// Counts pairs out of view as well, because culling must not change the image.
double max_texels_per_pair(const FramePlan& plan) {
  const auto pairs =
      static_cast<double>(std::bit_ceil(std::max<std::size_t>(plan.caster_receiver_pairs, 1)));
  return std::clamp(kMaxTexelsOfFrame / pairs, kMinTexelsOfPair, kMaxTexelsOfPair);
}

// Returns the bounds, on the plane, of the region in which the shadow may reach the surface.
Eigen::AlignedBox2d overlap(const ReceivedShadowDraw& draw, const ReceivingSurface& surface) {
  Eigen::AlignedBox2d box = surface.bounds();
  if (std::isfinite(draw.radius)) {
    const Eigen::Vector2d reach = Eigen::Vector2d::Constant(draw.radius);
    const Eigen::Vector2d& centre = draw.shadow.centre;
    box = box.intersection(Eigen::AlignedBox2d(centre - reach, centre + reach));
  }
  return box;
}

// Returns the size of a pixel at the nearest point of the shadowed receiver [m], rounded down to a
// power of two so that a moving camera rarely changes it.
double texel_for(const FramePlan& plan, const ReceivedShadowDraw& draw,
                 const ReceivingSurface& surface, const Model& model,
                 const Placement& T_table_object, double pixel_at_unit_depth) {
  const auto T_camera_table = plan.T_table_camera.inverse();
  const auto nearest = [&](const BoxCorners& corners) {
    double depth = std::numeric_limits<double>::infinity();
    for (const Eigen::Vector3d& corner : corners)
      depth = std::min(depth, (T_camera_table * corner).z());
    return depth;
  };
  double depth = nearest(box_corners(model, T_table_object));
  const Eigen::AlignedBox2d box = overlap(draw, surface);
  if (!box.isEmpty()) {
    const PlaneFrame& plane = draw.shadow.plane_frame;
    BoxCorners corners;
    for (unsigned i = 0; i < corners.size(); ++i) {
      corners[i] = plane.lift(((i & 1U) != 0U ? box.max() : box.min()).x(),
                              ((i & 2U) != 0U ? box.max() : box.min()).y()) +
                   ((i & 4U) != 0U ? std::max(draw.top, 0.0) : 0.0) * plane.n;
    }
    depth = std::max(depth, nearest(corners));
  }
  const double pixel = pixel_at_unit_depth * std::max(depth, kNearestDistance);
  return std::max(kFinestTexel, std::exp2(std::floor(std::log2(pixel))));
}

// Returns a camera straight above the plane, at depth 1, with `origin` and `origin + extent` at the
// mask's corners.
glm::mat4x3 camera_above(const Eigen::Vector2d& origin, const Eigen::Vector2d& extent) {
  const Eigen::Vector2d scale = 2.0 * extent.cwiseInverse();
  const Eigen::Vector2d shift = -origin.cwiseProduct(scale) - Eigen::Vector2d::Ones();
  return {glm::vec3(static_cast<float>(scale.x()), 0.0F, 0.0F),
          glm::vec3(0.0F, static_cast<float>(scale.y()), 0.0F), glm::vec3(0.0F),
          glm::vec3(static_cast<float>(shift.x()), static_cast<float>(shift.y()), 1.0F)};
}

}  // namespace

ReceivedShadowPass::ReceivedShadowPass(const CameraModel& camera, const ShadowGeometry& geometry,
                                       LayerPainter& painter, bool multisampled)
    : geometry_(geometry),
      painter_(painter),
      multisampled_(multisampled),
      pixel_at_unit_depth_(1.0 / std::max(camera.parameters().fx, camera.parameters().fy)) {}

const ReceivedShadowPass::Surface& ReceivedShadowPass::surface_of(const Scene& scene,
                                                                  const ObjectDraw& receiver,
                                                                  int plane,
                                                                  const PlaneFrame& frame) {
  Surface& surface = surfaces_[{receiver.object, plane}];
  surface.last_used = frame_count_;
  if (surface.version == 0 || !(surface.T_table_object == receiver.T_table_object) ||
      surface.pose_s != receiver.pose_s || !(surface.plane == frame)) {
    surface.version = ++surfaces_made_;
    surface.T_table_object = receiver.T_table_object;
    surface.pose_s = receiver.pose_s;
    surface.plane = frame;
    surface.faces =
        ReceivingSurface(*scene.objects[static_cast<std::size_t>(receiver.object)].model,
                         receiver.T_table_object, frame);
  }
  return surface;
}

bool ReceivedShadowPass::draws_on_cpu(const Scene& scene, const FramePlan& plan,
                                      const ShadowDraw& draw) const {
  if (plan.layers == LayerDrawing::direct) return false;
  if (draw.technique == ShadowTechnique::field) return true;
  CachedCaster& caster = geometry_.casters().caster_of(scene, draw);
  return !draws_directly(plan.layers, multisampled_, caster.mesh.indices.size() / 3) &&
         CasterCache::can_be_masked(draw, caster);
}

ReceivedShadowPass::Level ReceivedShadowPass::prepare_level(const Scene& scene,
                                                            const ReceivedShadowDraw& draw,
                                                            int level, const PlaneFrame& plane,
                                                            bool masked, RenderWork& work) {
  Level made;
  made.shadow = draw.shadow;
  made.shadow.plane_frame = plane;
  const ShadowDraw& shadow = made.shadow;
  CachedCaster& caster = geometry_.casters().caster_of(scene, shadow);
  PreparedShadow& prepared =
      levels_[{shadow.node, shadow.object, shadow.plane, draw.receiver, level}];
  made.item = {&caster, &prepared, shadow.node, shadow.object, shadow.plane, plane};
  prepared.last_used = frame_count_;
  prepared.surface = 0;  // the coarsest: masks have no lens distortion
  if (caster.is_empty()) {
    prepared.clear();
    return made;
  }
  // These counters count shadows, not levels.
  constexpr std::array kNotCounted = {Counter::reprojections, Counter::triples_recomputed,
                                      Counter::proxy_shadows};
  std::array<std::int64_t, kNotCounted.size()> before{};
  for (std::size_t i = 0; i < before.size(); ++i) before[i] = work[kNotCounted[i]];
  geometry_.prepare(shadow, caster, masked, prepared, work);
  for (std::size_t i = 0; i < before.size(); ++i) work[kNotCounted[i]] = before[i];
  return made;
}

int ReceivedShadowPass::make_mask(const Scene& scene, const ReceivedShadowDraw& draw,
                                  const Surface& surface, Mask& mask, RenderWork& work) {
  mask.has_shadow = false;
  mask.levels.clear();
  Eigen::AlignedBox2d box = overlap(draw, surface.faces);
  if (box.isEmpty()) return 0;
  // Considers only the part of the caster above the receiver.
  LevelSpacing spacing;
  const auto reach = geometry_.reach_of(scene, draw.shadow, surface.faces.lowest(box), work);
  if (reach) {
    box = box.intersection(reach->box);
    if (box.isEmpty()) return 0;
    spacing.clear_below = reach->low;
    // Keeps every outline accurate to one texel.
    spacing.clear_step = std::clamp(2.0 * mask.made_for->texel / std::max(reach->rate, 1e-9),
                                    kLevelStep, kMaxLevelStep);
  }
  const std::size_t max_levels =
      draw.shadow.technique == ShadowTechnique::field ? kMaxFieldLevels : kMaxReceivingLevels;
  mask.levels = surface.faces.levels(box, draw.top, max_levels, spacing);
  if (mask.levels.empty()) return 0;

  // Aligns the mask to a grid on the plane, which does not move with the caster.
  double texel = mask.made_for->texel;
  Eigen::Array2i size;
  for (;; texel *= 2.0) {
    mask.origin = (box.min() / texel).array().floor() * texel;
    const Eigen::Array2d texels = ((box.max() - mask.origin) / texel).array().ceil() + 1.0;
    if ((texels > kMaxTexels).any()) continue;
    size = ((texels / kTexelsAtOnce).ceil() * kTexelsAtOnce).cast<int>();
    if (static_cast<double>(size.prod()) * static_cast<double>(mask.levels.size()) <=
        mask.made_for->max_texels_per_pair)
      break;
  }
  mask.extent = size.cast<double>().matrix() * texel;
  mask.level_masks.resize(size.x(), size.y(), static_cast<int>(mask.levels.size()));
  const MaskCells cells{texel, std::llround(mask.origin.x() / texel),
                        std::llround(mask.origin.y() / texel), size.x(), size.y()};
  if (!mask.made_for->on_cpu) return draw_levels(scene, draw, surface, mask, work);
  cover_levels(scene, draw, surface, cells, mask, work);
  return 0;
}

void ReceivedShadowPass::cover_levels(const Scene& scene, const ReceivedShadowDraw& draw,
                                      const Surface& surface, const MaskCells& cells, Mask& mask,
                                      RenderWork& work) {
  coverage_.resize(std::size_t{4} * static_cast<std::size_t>(cells.width) *
                   static_cast<std::size_t>(cells.height));
  for (std::size_t level = 0; level < mask.levels.size(); ++level) {
    PlaneFrame plane = surface.plane;
    plane.q += mask.levels[level] * plane.n;
    cover_level(prepare_level(scene, draw, static_cast<int>(level), plane, true, work), cells,
                work);
    mask.has_shadow =
        mask.has_shadow || std::ranges::any_of(coverage_, [](std::uint8_t s) { return s != 0; });
    mask.level_masks.upload(static_cast<int>(level), coverage_);
  }
}

// Rasterises the exact coverage of these cells by each layer, without OpenGL.
void ReceivedShadowPass::cover_level(const Level& level, const MaskCells& cells, RenderWork& work) {
  std::ranges::fill(coverage_, std::uint8_t{0});
  if (!level.item.prepared->valid) return;
  const MaskPart part =
      MaskPart::of(level.shadow, *level.item.caster, *level.item.prepared, glm::vec3(0.0F));
  if (part.covers_nothing()) return;
  part.project(part.face_images(work), cells.size, mask_caster_, work);
  // Restricts the mask to the shadow's part over these cells.
  using Cell = Eigen::Vector<std::int64_t, 2>;
  const CellBox all(Cell(cells.u, cells.v),
                    Cell(cells.u + cells.width - 1, cells.v + cells.height - 1));
  const CellBox over = all.intersection(mask_caster_.bounds());
  if (over.isEmpty()) return;
  mask_raster_.begin({cells.size, over.min().x(), over.min().y(),
                      static_cast<int>(over.sizes().x()) + 1,
                      static_cast<int>(over.sizes().y()) + 1});
  part.cover(mask_caster_, mask_raster_);
  mask_raster_.finish_coverage(cells, coverage_);
}

int ReceivedShadowPass::draw_levels(const Scene& scene, const ReceivedShadowDraw& draw,
                                    const Surface& surface, Mask& mask, RenderWork& work) {
  const glm::mat4x3 camera = camera_above(mask.origin, mask.extent);
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  const LensUniforms straight;
  const LayerPainter::Brush white = painter_.plain();
  int calls = 0;
  for (std::size_t i = 0; i < mask.levels.size(); ++i) {
    PlaneFrame plane = surface.plane;
    plane.q += mask.levels[i] * plane.n;
    Level level = prepare_level(scene, draw, static_cast<int>(i), plane, false, work);
    level.shadow.fractions = {1.0, 1.0, 1.0};
    mask.level_masks.begin(static_cast<int>(i));
    for (int layer = 0; layer < 3; ++layer) {
      glColorMask(layer == 0 ? GL_TRUE : GL_FALSE, layer == 1 ? GL_TRUE : GL_FALSE,
                  layer == 2 ? GL_TRUE : GL_FALSE, GL_FALSE);
      painter_.begin_plane(white, straight, camera);
      const int drawn = painter_.draw(level.shadow, level.item, layer, 1, white);
      mask.has_shadow = mask.has_shadow || drawn > 0;
      calls += drawn;
    }
    glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
    mask.level_masks.end();
  }
  return calls;
}

Result<void> ReceivedShadowPass::prepare(const DrawContext& context, const FramePlan& plan) {
  const Scene& scene = context.scene;
  RenderWork& work = context.work;
  ++frame_count_;
  calls_ = 0;
  shown_.clear();
  if (!plan.reuse) {
    masks_.clear();
    surfaces_.clear();
    levels_.clear();
  }
  const double texels = max_texels_per_pair(plan);
  for (const ReceivedShadowDraw& draw : plan.received_shadows) {
    const ObjectDraw* receiver = drawn_object(plan, draw.receiver);
    if (receiver == nullptr) continue;
    const Surface& surface =
        surface_of(scene, *receiver, draw.shadow.plane, draw.shadow.plane_frame);
    Masks& masks = masks_[{draw.shadow.node, draw.shadow.object, draw.shadow.plane, draw.receiver}];
    masks.last_used = frame_count_;
    const double texel = texel_for(plan, draw, surface.faces,
                                   *scene.objects[static_cast<std::size_t>(draw.receiver)].model,
                                   receiver->T_table_object, pixel_at_unit_depth_);
    const MaskInputs inputs{draw.shadow, surface.version, draw.top,
                            texel,       texels,          draws_on_cpu(scene, plan, draw.shadow)};
    const auto matches = [&](const Mask& mask) { return mask.made_for == inputs; };
    if (!matches(masks.latest)) std::swap(masks.latest, masks.earlier);
    Mask& mask = masks.latest;
    const bool kept = matches(mask);
    if (!kept) {
      mask.made_for = inputs;
      calls_ += make_mask(scene, draw, surface, mask, work);
    }
    if (kept && !mask.levels.empty()) {
      work.kept.push_back({KeepReason::phantom_mask, draw.receiver, draw.shadow.object});
    }
    work[kept ? Counter::masks_kept : Counter::masks_drawn] +=
        static_cast<std::int64_t>(mask.levels.size());
    if (mask.has_shadow) shown_.push_back({&mask, &draw, *receiver});
  }
  const auto unused = [this](const auto& entry) {
    return entry.second.last_used + kFramesKept < frame_count_;
  };
  std::erase_if(masks_, unused);
  std::erase_if(surfaces_, unused);
  std::erase_if(levels_, unused);
  return {};
}

int ReceivedShadowPass::draw_shadow(const DrawContext& context, const FramePlan& plan,
                                    const Shown& shown, Gathering gathering) {
  const Mask& mask = *shown.mask;
  mask.level_masks.bind(kShadowMaskUnit);
  ShadowMask uniforms;
  uniforms.plane_from_table = plane_from_object(shown.draw->shadow.plane_frame, Placement());
  uniforms.normal = to_gl(shown.draw->shadow.plane_frame.n);
  uniforms.origin = {static_cast<float>(mask.origin.x()), static_cast<float>(mask.origin.y())};
  uniforms.extent = {static_cast<float>(mask.extent.x()), static_cast<float>(mask.extent.y())};
  uniforms.encoded_factors = layer_light(shown.draw->shadow);
  uniforms.level_count = static_cast<int>(mask.levels.size());
  for (std::size_t i = 0; i < mask.levels.size(); ++i) {
    uniforms.levels[i / 4][static_cast<glm::length_t>(i % 4)] = static_cast<float>(mask.levels[i]);
  }
  return context.objects.draw_under_shadow(shown.receiver, plan, context.lens, uniforms, gathering);
}

// Darkens a receiver by the shadows of several casters. In the modes blend and retexture, first
// gathers the darkest values in the framebuffer's alpha.
int ReceivedShadowPass::draw_casters(const DrawContext& context, const FramePlan& plan,
                                     const std::vector<const Shown*>& casters) const {
  const bool blended = context.mode == Translucency::blend;
  const bool retextured = context.mode == Translucency::retexture;
  Framebuffer& framebuffer = context.framebuffer;
  const auto darken = [&](const Shown& shown, Gathering gathering) {
    begin_translucent(context.mode, Blending::darken);
    // In mode blend, a pixel must be drawn once even if faces coincide. In the other modes,
    // repeated drawing has no effect.
    if (blended) {
      if (gathering == Gathering::result)
        glBlendFuncSeparate(GL_ZERO, GL_DST_ALPHA, GL_ONE, GL_ZERO);
      glEnable(GL_STENCIL_TEST);
    }
    return draw_shadow(context, plan, shown, gathering);
  };
  int calls = 0;
  if (casters.size() == 1 || !(blended || retextured)) {
    for (const Shown* shown : casters) calls += darken(*shown, Gathering::none);
    return calls;
  }
  glDisable(GL_STENCIL_TEST);
  for (const Shown* shown : casters) {
    const bool first = shown == casters.front();
    if (blended && !first) {
      glEnable(GL_BLEND);
      glBlendFunc(GL_ONE, GL_ONE);
      glBlendEquation(GL_MIN);
    } else {
      glDisable(GL_BLEND);
    }
    if (retextured && !first) framebuffer.copy_image(kFramebufferCopyUnit);
    glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_TRUE);
    calls += draw_shadow(context, plan, *shown, first ? Gathering::first : Gathering::further);
  }
  glBlendEquation(GL_FUNC_ADD);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  if (retextured) framebuffer.copy_image(kFramebufferCopyUnit);
  return calls + darken(*casters.front(), Gathering::result);
}

int ReceivedShadowPass::draw(const DrawContext& context, const FramePlan& plan) {
  int calls = calls_;
  if (shown_.empty()) return calls;
  glStencilFunc(GL_EQUAL, 0, 0xFF);
  glStencilOp(GL_KEEP, GL_KEEP, GL_INCR);
  glDisable(GL_STENCIL_TEST);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_EQUAL);
  glDepthMask(GL_FALSE);
  // Parallel planes share a light, so a pixel in the shadows for several of them is darkened once.
  std::vector<const Shown*> left;
  for (const Shown& shown : shown_) left.push_back(&shown);
  while (!left.empty()) {
    const Eigen::Vector3d normal = left.front()->draw->shadow.plane_frame.n;
    const auto not_parallel = std::ranges::stable_partition(left, [&normal](const Shown* shown) {
      return (shown->draw->shadow.plane_frame.n - normal).norm() < 1e-3;
    });
    std::map<int, std::vector<const Shown*>> over;  // by receiver: a pixel shows only one object
    for (auto shown = left.begin(); shown != not_parallel.begin(); ++shown)
      over[(*shown)->receiver.object].push_back(*shown);
    left.erase(left.begin(), not_parallel.begin());
    if (context.mode == Translucency::blend) context.receivers.clear_stencil();
    if (context.mode == Translucency::retexture)
      context.framebuffer.copy_image(kFramebufferCopyUnit);
    for (const auto& [receiver, casters] : over) calls += draw_casters(context, plan, casters);
  }
  MaskStack::unbind(kShadowMaskUnit);
  end_translucent();
  glDisable(GL_STENCIL_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  return calls;
}

}  // namespace penumbra
