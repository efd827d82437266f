#include "render/passes/hard_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <limits>
#include <set>
#include <utility>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "render/passes/uniforms.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/projected/projected_shadow.hpp"

namespace penumbra {

Result<std::unique_ptr<HardPass>> HardPass::create(GlApi api, const CameraModel& camera) {
  auto pass = std::make_unique<HardPass>();
  PENUMBRA_TRY(
      pass->shape_program_,
      ShaderProgram::link(api, {"lens.glsl", "plane_shape.vert.glsl"}, {"fill.frag.glsl"}));
  PENUMBRA_TRY(pass->light_program_, plane_light_program(api));
  if (camera.has_distortion()) pass->longest_edge_ = longest_edge(camera);
  return pass;
}

void HardPass::make(const HardShadowDraw& draw, const ShadowMesh& mesh, Shadow& shadow,
                    RenderWork& work) {
  shadow.made_for = draw;
  const ShadowKernels none{draw.plane_frame.n, mesh.positions, {}};
  const std::vector<CasterVertex> vertices =
      place_caster(mesh, none, draw.T_table_object, draw.plane_frame);
  work[Counter::shadow_vertices] += static_cast<std::int64_t>(vertices.size());
  std::vector<PlanePoint> triangles =
      projected_triangles(vertices, mesh.indices, draw.light_position, draw.plane_frame);
  if (longest_edge_) {
    triangles = split_for_lens(std::move(triangles),
                               draw.plane_frame.to_plane(Eigen::Vector3d::Zero()).head<2>(),
                               *longest_edge_);
  }
  shadow.bounds.setEmpty();
  for (const PlanePoint& p : triangles)
    shadow.bounds.extend(Eigen::Vector2d(static_cast<double>(p.u), static_cast<double>(p.v)));
  shadow.triangles.write(triangles, BufferLife::every_frame);
}

Result<void> HardPass::prepare(const DrawContext& context, const FramePlan& plan) {
  PENUMBRA_TRY_VOID(light_program_.choose(context.mode, context.video_format));
  RenderWork& work = context.work;
  std::set<Key> seen;  // several nodes may have the same shadow
  for (const HardShadowDraw& draw : plan.hard_shadows) {
    const Key key = {draw.object, draw.plane, draw.light};
    if (!seen.insert(key).second) continue;
    Shadow& shadow = shadows_[key];
    if (const auto& made = shadow.made_for;
        plan.reuse && made && made->plane_frame == draw.plane_frame &&
        made->T_table_object == draw.T_table_object && made->pose_s == draw.pose_s &&
        made->light_position == draw.light_position) {
      ++work[Counter::reprojections];
      continue;
    }
    ++work[Counter::triples_recomputed];
    const ShadowMesh& mesh = meshes_.of(
        context.scene, draw.object, draw.proxy,
        [](const Model& model) { return make_shadow_mesh(model, {}, CutOuts::visible_regions); });
    make(draw, mesh, shadow, work);
  }
  return {};
}

std::vector<HardPass::BlockedLight> HardPass::blocked_lights(const FramePlan& plan,
                                                             const PlaneReceiver& receiver) const {
  const auto strength_of = [&](const HardShadowDraw& draw) {
    return receiver.opacity > 0.0F ? std::min(1.0F, draw.opacity / receiver.opacity) : 0.0F;
  };
  std::set<std::pair<int, float>> kinds;
  for (const HardShadowDraw& draw : plan.hard_shadows) {
    if (draw.plane == receiver.plane) kinds.emplace(draw.light, strength_of(draw));
  }
  const bool separate = kinds.size() <= kMaxHardLights;  // else one bit per light
  std::vector<BlockedLight> lights;
  std::set<Key> seen;
  for (const HardShadowDraw& draw : plan.hard_shadows) {
    if (draw.plane != receiver.plane) continue;
    const Key key = {draw.object, draw.plane, draw.light};
    const Shadow& shadow = shadows_.at(key);
    if (shadow.triangles.count() == 0 || !seen.insert(key).second) continue;
    const float strength = strength_of(draw);
    auto found = std::ranges::find_if(lights, [&](const BlockedLight& known) {
      return known.light == draw.light && (!separate || known.strength == strength);
    });
    if (found == lights.end()) {
      PENUMBRA_ASSERT(lights.size() < kMaxHardLights);
      found = lights.insert(found, {draw.light, strength, {}, {}});
    }
    found->strength = std::max(found->strength, strength);
    found->bounds.extend(shadow.bounds);
    found->shadows.push_back(&shadow);
  }
  return lights;
}

int HardPass::draw_plane(const DrawContext& context, const FramePlan& plan,
                         const PlaneReceiver& receiver) const {
  const LensUniforms& lens = context.lens;
  Receivers& receivers = context.receivers;
  const std::vector<BlockedLight> lights = blocked_lights(plan, receiver);
  if (lights.empty()) return 0;

  receivers.begin_plane(plan, receiver.plane, receiver.frame, lens);
  int calls = 0;
  shape_program_.use();
  set_lens(shape_program_, lens);
  shape_program_.set("camera_from_plane", camera_from_plane(plan.T_table_camera, receiver.frame));
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDisable(GL_BLEND);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  for (std::size_t i = 0; i < lights.size(); ++i) {
    const unsigned bit = 1U << i;
    glStencilMask(bit);
    receivers.stencil_test(bit, 0);
    for (const Shadow* shadow : lights[i].shadows) {
      shadow->triangles.draw(GL_TRIANGLES);
      ++calls;
    }
  }

  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glStencilMask(0);
  glStencilOp(GL_KEEP, GL_KEEP, GL_KEEP);
  glDisable(GL_DEPTH_TEST);
  begin_translucent(context.mode, Blending::darken);
  const ShaderProgram& p = light_program_.get();
  begin_plane_light(p, plan, receiver.frame, receiver.opacity);
  const unsigned all = (1U << lights.size()) - 1U;
  std::vector<float> blocked(plan.lights.size());
  for (unsigned set = 1; set <= all; ++set) {
    std::ranges::fill(blocked, 0.0F);
    const double infinity = std::numeric_limits<double>::infinity();
    Eigen::AlignedBox2d overlap(Eigen::Vector2d::Constant(-infinity),
                                Eigen::Vector2d::Constant(infinity));
    for (std::size_t i = 0; i < lights.size(); ++i) {
      if ((set >> i & 1U) == 0) continue;
      float& of_light = blocked[static_cast<std::size_t>(lights[i].light)];
      of_light = std::max(of_light, lights[i].strength);
      overlap = overlap.intersection(lights[i].bounds);
    }
    if (overlap.isEmpty()) continue;
    set_lights(p, plan, blocked);
    receivers.stencil_test(set, all);
    receivers.draw_grid(p, plan, receiver.frame, lens);
    ++calls;
  }
  return calls;
}

int HardPass::draw(const DrawContext& context, const FramePlan& plan) {
  if (plan.hard_shadows.empty()) return 0;
  // One copy is enough, because a pixel shows no more than one plane.
  if (context.mode == Translucency::retexture) context.framebuffer.copy_image(kFramebufferCopyUnit);
  int calls = 0;
  for (const PlaneReceiver& receiver : plan.receivers) {
    calls += draw_plane(context, plan, receiver);
  }
  end_planes();
  return calls;
}

}  // namespace penumbra
