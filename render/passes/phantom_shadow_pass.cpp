#include "render/passes/phantom_shadow_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>

#include "render/shadow/receiving_levels.hpp"
#include "render/to_eigen.hpp"

namespace penumbra {
namespace {

// Each level of a field is computed anew when its caster is lifted.
constexpr std::size_t kMostFieldLevels = 6;
constexpr double kTexel = 4e-4;  // [m]; less than a pixel but from very near
constexpr double kLeastTexels = 32.0;
constexpr double kMostTexels = 1024.0;

bool same(const Placement& a, const Placement& b) {
  return a.position == b.position && a.rotation.coeffs() == b.rotation.coeffs() &&
         a.scale == b.scale;
}
bool same(const PlaneFrame& a, const PlaneFrame& b) {
  return a.n == b.n && a.q == b.q;
}
// Whether they look alike; which layers are seen on the plane does not count.
bool same(const ShadowDraw& a, const ShadowDraw& b) {
  const LayeredConstants& c = a.constants;
  const LayeredConstants& d = b.constants;
  return a.node == b.node && a.object == b.object && a.technique == b.technique &&
         a.kernels == b.kernels && a.light_mode == b.light_mode && a.proxy == b.proxy &&
         same(a.plane_frame, b.plane_frame) && same(a.T_table_object, b.T_table_object) &&
         c.light_height == d.light_height && c.light_ratio == d.light_ratio &&
         c.umbra_height == d.umbra_height && c.magnification_cap == d.magnification_cap &&
         a.fractions.umbra == b.fractions.umbra && a.fractions.middle == b.fractions.middle &&
         a.fractions.penumbra == b.fractions.penumbra && a.opacity == b.opacity;
}

int texels_for(double extent) {
  return static_cast<int>(
      std::exp2(std::ceil(std::log2(std::clamp(extent / kTexel, kLeastTexels, kMostTexels)))));
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

int PhantomShadowPass::draw_mask(const Scene& scene,
                                 const std::vector<const PhantomShadowDraw*>& draws, Mask& mask,
                                 ShadowPass& shadows, ShadowWork& work) {
  const Model& model = *scene.objects[static_cast<std::size_t>(mask.phantom.object)].model;
  const bool field = std::ranges::any_of(
      draws, [](const auto* draw) { return draw->shadow.technique == ShadowTechnique::field; });
  mask.levels = receiving_levels(model, mask.phantom.T_table_object, mask.plane,
                                 field ? kMostFieldLevels : kMostReceivingLevels);
  if (mask.levels.empty()) return 0;
  Eigen::AlignedBox2d box;
  for (int i = 0; i < 8; ++i) {
    const glm::vec3 corner((i & 1) != 0 ? model.max_corner.x : model.min_corner.x,
                           (i & 2) != 0 ? model.max_corner.y : model.min_corner.y,
                           (i & 4) != 0 ? model.max_corner.z : model.min_corner.z);
    box.extend(mask.plane.to_plane(mask.phantom.T_table_object * to_eigen(corner)).head<2>());
  }
  mask.origin = box.min().array() - kTexel;
  mask.extent = box.sizes().array() + 2.0 * kTexel;
  mask.pictures.resize(texels_for(mask.extent.x()), texels_for(mask.extent.y()),
                       static_cast<int>(mask.levels.size()));
  const LensUniforms straight;
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  int calls = 0;
  for (std::size_t level = 0; level < mask.levels.size(); ++level) {
    PlaneFrame plane = mask.plane;
    plane.q += mask.levels[level] * plane.n;
    std::vector<std::size_t> flats;
    for (const PhantomShadowDraw* draw : draws) {
      flats.push_back(shadows.prepare_flat(scene, *draw, static_cast<int>(level), plane, work));
    }
    mask.pictures.begin(static_cast<int>(level));
    // The darkest of what is there, whatever comes first.
    glEnable(GL_BLEND);
    glBlendEquation(GL_MIN);
    for (const std::size_t flat : flats) {
      calls += shadows.draw_flat(flat, straight, camera_above(mask.origin, mask.extent));
    }
    glBlendEquation(GL_FUNC_ADD);
    glDisable(GL_BLEND);
  }
  return calls;
}

int PhantomShadowPass::prepare(const Scene& scene, const FramePlan& plan, ShadowPass& shadows,
                               ShadowWork& work) {
  shown_.clear();
  int calls = 0;
  for (const PlaneReceiver& receiver : plan.receivers) {
    for (const ObjectDraw& phantom : plan.phantoms) {
      std::vector<const PhantomShadowDraw*> draws;
      for (const PhantomShadowDraw& draw : plan.phantom_shadows) {
        if (draw.phantom == phantom.object && draw.shadow.plane == receiver.plane) {
          draws.push_back(&draw);
        }
      }
      if (draws.empty()) continue;
      const Key key{phantom.object, receiver.plane};
      Mask& mask = masks_[key];
      const bool kept =
          mask.valid && same(mask.phantom.T_table_object, phantom.T_table_object) &&
          same(mask.plane, receiver.frame) &&
          std::ranges::equal(mask.shadows, draws,
                             [](const ShadowDraw& a, const auto* b) { return same(a, b->shadow); });
      if (!kept) {
        mask.valid = true;
        mask.phantom = phantom;
        mask.plane = receiver.frame;
        mask.shadows.clear();
        for (const PhantomShadowDraw* draw : draws) mask.shadows.push_back(draw->shadow);
        calls += draw_mask(scene, draws, mask, shadows, work);
      }
      if (mask.levels.empty()) continue;
      const auto levels = static_cast<std::int64_t>(mask.levels.size());
      (kept ? work.masks_kept : work.masks_drawn) += levels;
      shown_.push_back(key);
    }
  }
  return calls;
}

int PhantomShadowPass::draw(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
                            const ObjectPass& objects) const {
  if (shown_.empty()) return 0;
  glEnable(GL_STENCIL_TEST);
  glStencilMask(0xFF);
  glClear(GL_STENCIL_BUFFER_BIT);
  // Each pixel once: what lies in the same place, or faces two planes, darkens no further.
  glStencilFunc(GL_EQUAL, 0, 0xFF);
  glStencilOp(GL_KEEP, GL_KEEP, GL_INCR);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_EQUAL);
  glDepthMask(GL_FALSE);
  glEnable(GL_BLEND);
  glBlendFunc(GL_ZERO, GL_SRC_COLOR);
  int calls = 0;
  for (const Key& key : shown_) {
    const Mask& mask = masks_.at(key);
    mask.pictures.bind(kShadowMaskUnit);
    ShadowMask uniforms;
    uniforms.plane_from_table = plane_from_object(mask.plane, Placement());
    uniforms.normal = to_gl(mask.plane.n);
    uniforms.origin = {static_cast<float>(mask.origin.x()), static_cast<float>(mask.origin.y())};
    uniforms.extent = {static_cast<float>(mask.extent.x()), static_cast<float>(mask.extent.y())};
    uniforms.level_count = static_cast<int>(mask.levels.size());
    for (std::size_t i = 0; i < mask.levels.size(); ++i) {
      uniforms.levels[i / 4][static_cast<glm::length_t>(i % 4)] =
          static_cast<float>(mask.levels[i]);
    }
    calls += objects.draw_under_shadows(scene, mask.phantom, plan, lens, uniforms);
  }
  glDisable(GL_BLEND);
  glDisable(GL_STENCIL_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  return calls;
}

}  // namespace penumbra
