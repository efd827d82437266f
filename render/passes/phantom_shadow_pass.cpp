#include "render/passes/phantom_shadow_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>

#include "core/assert.hpp"

namespace penumbra {
namespace {

// Each level of a field is computed anew when its caster is lifted.
constexpr std::size_t kMostFieldLevels = 16;
constexpr double kTexel = 5e-4;    // [m]; less than a pixel but from very near
constexpr int kMostTexels = 1024;  // along a side
constexpr double kMostTexelsInAll = 4e6;
constexpr int kTexelsAtOnce = 32;  // sides are whole numbers of these: storage changes rarely

// Whether their layers have the same shapes. How dark they are, and which are seen on the plane,
// does not count.
bool same_shapes(const ShadowDraw& a, const ShadowDraw& b) {
  return a.technique == b.technique && a.kernels == b.kernels && a.light_mode == b.light_mode &&
         a.proxy == b.proxy && a.plane_frame == b.plane_frame &&
         a.T_table_object == b.T_table_object && a.constants == b.constants;
}

// The part of the plane where the shadow may meet the surface.
Eigen::AlignedBox2d meeting(const PhantomShadowDraw& draw, const ReceivingSurface& surface) {
  Eigen::AlignedBox2d box = surface.bounds();
  if (std::isfinite(draw.radius)) {
    const Eigen::Vector2d reach = Eigen::Vector2d::Constant(draw.radius);
    box = box.intersection(Eigen::AlignedBox2d(draw.centre - reach, draw.centre + reach));
  }
  return box;
}

// The plane from straight above, `origin` and `extent` in the picture's corners: at depth 1
// everywhere, so that nothing is farther away than anything else.
glm::mat4x3 camera_above(const Eigen::Vector2d& origin, const Eigen::Vector2d& extent) {
  const Eigen::Vector2d scale = 2.0 * extent.cwiseInverse();
  const Eigen::Vector2d shift = -origin.cwiseProduct(scale) - Eigen::Vector2d::Ones();
  return {glm::vec3(static_cast<float>(scale.x()), 0.0F, 0.0F),
          glm::vec3(0.0F, static_cast<float>(scale.y()), 0.0F), glm::vec3(0.0F),
          glm::vec3(static_cast<float>(shift.x()), static_cast<float>(shift.y()), 1.0F)};
}

}  // namespace

const PhantomShadowPass::Surface& PhantomShadowPass::surface_of(const Scene& scene,
                                                                const ObjectDraw& phantom,
                                                                int plane,
                                                                const PlaneFrame& frame) {
  Surface& surface = surfaces_[{phantom.object, plane}];
  surface.last_used = frame_count_;
  if (surface.version == 0 || !(surface.T_table_object == phantom.T_table_object) ||
      !(surface.plane == frame)) {
    surface.version = ++surfaces_made_;
    surface.T_table_object = phantom.T_table_object;
    surface.plane = frame;
    surface.faces = ReceivingSurface(*scene.objects[static_cast<std::size_t>(phantom.object)].model,
                                     phantom.T_table_object, frame);
  }
  return surface;
}

int PhantomShadowPass::draw_mask(const Scene& scene, const PhantomShadowDraw& draw,
                                 const Surface& surface, Mask& mask, ShadowPass& shadows,
                                 ShadowWork& work) {
  mask.layers = {};
  mask.levels.clear();
  const Eigen::AlignedBox2d box = meeting(draw, surface.faces);
  if (box.isEmpty()) return 0;
  const std::size_t most =
      draw.shadow.technique == ShadowTechnique::field ? kMostFieldLevels : kMostReceivingLevels;
  mask.levels = surface.faces.levels(box, draw.top, most);
  if (mask.levels.empty()) return 0;

  // On a grid that stays where it is while the caster slides.
  double texel = kTexel;
  Eigen::Array2i size;
  for (;; texel *= 2.0) {
    mask.origin = (box.min() / texel).array().floor() * texel;
    const Eigen::Array2d texels = ((box.max() - mask.origin) / texel).array().ceil() + 1.0;
    if ((texels > kMostTexels).any()) continue;
    size = ((texels / kTexelsAtOnce).ceil() * kTexelsAtOnce).cast<int>();
    if (static_cast<double>(size.prod()) * static_cast<double>(mask.levels.size()) <=
        kMostTexelsInAll)
      break;
  }
  mask.extent = size.cast<double>().matrix() * texel;
  mask.pictures.resize(size.x(), size.y(), static_cast<int>(mask.levels.size()));

  const LensUniforms straight;
  const glm::mat4x3 camera = camera_above(mask.origin, mask.extent);
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  int calls = 0;
  for (std::size_t level = 0; level < mask.levels.size(); ++level) {
    PlaneFrame plane = surface.plane;
    plane.q += mask.levels[level] * plane.n;
    const std::size_t flat =
        shadows.prepare_flat(scene, draw, static_cast<int>(level), plane, work);
    mask.pictures.begin(static_cast<int>(level));
    for (int layer = 0; layer < 3; ++layer) {
      glColorMask(layer == 0 ? GL_TRUE : GL_FALSE, layer == 1 ? GL_TRUE : GL_FALSE,
                  layer == 2 ? GL_TRUE : GL_FALSE, GL_FALSE);
      const int drawn = shadows.draw_flat(flat, layer, straight, camera);
      if (drawn > 0) mask.layers[static_cast<std::size_t>(layer)] = true;
      calls += drawn;
    }
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  return calls;
}

int PhantomShadowPass::prepare(const Scene& scene, const FramePlan& plan, ShadowPass& shadows,
                               ShadowWork& work) {
  ++frame_count_;
  shown_.clear();
  int calls = 0;
  for (const PhantomShadowDraw& draw : plan.phantom_shadows) {
    const auto phantom = std::ranges::find(plan.phantoms, draw.phantom, &ObjectDraw::object);
    PENUMBRA_ASSERT(phantom != plan.phantoms.end());
    const Surface& surface =
        surface_of(scene, *phantom, draw.shadow.plane, draw.shadow.plane_frame);
    Mask& mask = masks_[{draw.shadow.node, draw.shadow.object, draw.shadow.plane, draw.phantom}];
    mask.last_used = frame_count_;
    const bool kept = mask.valid && mask.surface == surface.version && mask.top == draw.top &&
                      same_shapes(mask.shadow, draw.shadow);
    if (!kept) {
      mask.valid = true;
      mask.surface = surface.version;
      mask.top = draw.top;
      mask.shadow = draw.shadow;
      calls += draw_mask(scene, draw, surface, mask, shadows, work);
    }
    (kept ? work.masks_kept : work.masks_drawn) += static_cast<std::int64_t>(mask.levels.size());
    if (std::ranges::find(mask.layers, true) != mask.layers.end()) {
      shown_.push_back({&mask, &draw, *phantom});
    }
  }
  const auto unused = [this](const auto& entry) {
    return entry.second.last_used + kFramesKept < frame_count_;
  };
  std::erase_if(masks_, unused);
  std::erase_if(surfaces_, unused);
  return calls;
}

int PhantomShadowPass::draw_layer(const Scene& scene, const FramePlan& plan,
                                  const LensUniforms& lens, const ObjectPass& objects,
                                  const Shown& shown, int layer) {
  const Mask& mask = *shown.mask;
  if (!mask.layers[static_cast<std::size_t>(layer)]) return 0;
  mask.pictures.bind(kShadowMaskUnit);
  ShadowMask uniforms;
  uniforms.plane_from_table = plane_from_object(shown.draw->shadow.plane_frame, Placement());
  uniforms.normal = to_gl(shown.draw->shadow.plane_frame.n);
  uniforms.origin = {static_cast<float>(mask.origin.x()), static_cast<float>(mask.origin.y())};
  uniforms.extent = {static_cast<float>(mask.extent.x()), static_cast<float>(mask.extent.y())};
  uniforms.layer = layer;
  uniforms.light_left = layer_light(shown.draw->shadow)[layer];
  uniforms.level_count = static_cast<int>(mask.levels.size());
  for (std::size_t i = 0; i < mask.levels.size(); ++i) {
    uniforms.levels[i / 4][static_cast<glm::length_t>(i % 4)] = static_cast<float>(mask.levels[i]);
  }
  return objects.draw_under_shadow(scene, shown.phantom, plan, lens, uniforms);
}

int PhantomShadowPass::draw(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
                            const ObjectPass& objects, Translucency way,
                            Framebuffer& framebuffer) const {
  if (shown_.empty()) return 0;
  // Each pixel once: blended, by the stencil; retextured, what comes first is drawn last.
  const bool once = way == Translucency::blend;
  const bool last_is_seen = way == Translucency::retexture;
  glStencilMask(0xFF);
  if (once) {
    glEnable(GL_STENCIL_TEST);
    glStencilFunc(GL_EQUAL, 0, 0xFF);
    glStencilOp(GL_KEEP, GL_KEEP, GL_INCR);
  } else {
    glDisable(GL_STENCIL_TEST);
  }
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_EQUAL);
  glDepthMask(GL_FALSE);
  begin_darkening(way);
  int calls = 0;
  // Planes that are parallel have one light: what lies in its shadow for several is darkened once.
  std::vector<const Shown*> left;
  for (const Shown& shown : shown_) left.push_back(&shown);
  while (!left.empty()) {
    const Eigen::Vector3d normal = left.front()->draw->shadow.plane_frame.n;
    const auto other = std::ranges::stable_partition(left, [&normal](const Shown* shown) {
      return (shown->draw->shadow.plane_frame.n - normal).norm() < 1e-3;
    });
    std::vector<const Shown*> together(left.begin(), other.begin());
    left.erase(left.begin(), other.begin());
    if (once) glClear(GL_STENCIL_BUFFER_BIT);
    if (last_is_seen) {
      framebuffer.copy_picture(kPictureBeforeUnit);
      std::ranges::reverse(together);
    }
    for (int i = 0; i < 3; ++i) {
      const int layer = last_is_seen ? 2 - i : i;
      for (const Shown* shown : together)
        calls += draw_layer(scene, plan, lens, objects, *shown, layer);
    }
  }
  MaskStack::unbind(kShadowMaskUnit);
  glClear(GL_STENCIL_BUFFER_BIT);
  end_translucent();
  glDisable(GL_STENCIL_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  return calls;
}

}  // namespace penumbra
