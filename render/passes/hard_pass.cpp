#include "render/passes/hard_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <limits>
#include <set>
#include <utility>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "render/passes/lens_uniforms.hpp"
#include "render/passes/light_uniforms.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/projected/projected_shadow.hpp"

namespace penumbra {

Result<std::unique_ptr<HardPass>> HardPass::create(GlApi api, const Scene& scene,
                                                   const CameraModel& camera) {
  if (scene.lights.size() > kMaxLights) {
    return fail("{}: lights: {} of them; at most {} can be drawn", scene.file, scene.lights.size(),
                kMaxLights);
  }
  constexpr std::array<std::string_view, 2> kShape = {"lens.glsl", "plane_shape.vert.glsl"};
  constexpr std::array<std::string_view, 1> kNothing = {"outline.frag.glsl"};
  constexpr std::array<std::string_view, 2> kReceiver = {"lens.glsl", "receiver.vert.glsl"};
  constexpr std::array<std::string_view, 3> kLight = {"ambient.glsl", "light_share.glsl",
                                                      "blocked_light.frag.glsl"};
  PENUMBRA_TRY(auto shape, ShaderProgram::link(api, kShape, kNothing));
  PENUMBRA_TRY(auto light, TranslucentProgram::create(api, kReceiver, kLight, kLightDefines));
  std::unique_ptr<HardPass> pass(new HardPass(std::move(shape), std::move(light)));
  if (make_lens(camera).model != 0) pass->longest_edge_ = longest_edge(camera);
  return pass;
}

const ShadowMesh& HardPass::mesh_of(const Scene& scene, const HardShadowDraw& draw) {
  const Model* model =
      casting_model(scene.objects[static_cast<std::size_t>(draw.object)], draw.proxy).get();
  auto& entry = meshes_[model];
  if (!entry)
    entry = std::make_unique<ShadowMesh>(make_shadow_mesh(*model, {}, CutOuts::what_is_seen));
  return *entry;
}

void HardPass::make(const HardShadowDraw& draw, const ShadowMesh& mesh, Shadow& shadow,
                    RenderWork& work) {
  shadow.valid = true;
  shadow.plane = draw.plane_frame;
  shadow.T_table_object = draw.T_table_object;
  shadow.light = draw.light_place;
  const ShadowKernels none{draw.plane_frame.n, mesh.positions, {}};
  const std::vector<CasterVertex> vertices =
      place_caster(mesh, none, draw.T_table_object, draw.plane_frame);
  work[Counter::shadow_vertices] += static_cast<std::int64_t>(vertices.size());
  std::vector<PlanePoint> triangles =
      projected_triangles(vertices, mesh.indices, draw.light_place, draw.plane_frame);
  if (longest_edge_) {
    triangles = split_for_lens(std::move(triangles),
                               draw.plane_frame.to_plane(Eigen::Vector3d::Zero()).head<2>(),
                               *longest_edge_);
  }
  shadow.low.setConstant(std::numeric_limits<double>::infinity());
  shadow.high = -shadow.low;
  for (const PlanePoint& p : triangles) {
    const Eigen::Vector2d point(static_cast<double>(p.u), static_cast<double>(p.v));
    shadow.low = shadow.low.cwiseMin(point);
    shadow.high = shadow.high.cwiseMax(point);
  }
  shadow.count = static_cast<int>(triangles.size());
  shadow.layout.bind();
  shadow.vertices.write(std::span<const PlanePoint>(triangles), BufferLife::every_frame);
  if (!shadow.layout_made) {
    VertexArray::attribute(0, 2, sizeof(PlanePoint), 0);
    shadow.layout_made = true;
  }
}

Result<void> HardPass::prepare(const DrawContext& context, const FramePlan& plan) {
  PENUMBRA_TRY_VOID(light_program_.choose(context.mode, context.video_format));
  RenderWork& work = context.work;
  std::set<Key> seen;  // several nodes may ask for the same shadow
  for (const HardShadowDraw& draw : plan.hard_shadows) {
    const Key key = {draw.object, draw.plane, draw.light};
    if (!seen.insert(key).second) continue;
    Shadow& shadow = shadows_[key];
    if (plan.reuse && shadow.valid && shadow.plane == draw.plane_frame &&
        shadow.T_table_object == draw.T_table_object && shadow.light == draw.light_place) {
      ++work[Counter::reprojections];
      continue;
    }
    ++work[Counter::triples_recomputed];
    make(draw, mesh_of(context.scene, draw), shadow, work);
  }
  return {};
}

int HardPass::draw_plane(const DrawContext& context, const FramePlan& plan,
                         const PlaneReceiver& receiver) const {
  const LensUniforms& lens = context.lens;
  Receivers& receivers = context.receivers;
  // What one bit stands for: casters that are equally strong, of one light.
  struct Blocked {
    int light = 0;
    float strength = 1.0F;
    Eigen::Vector2d low, high;
  };
  const auto strength_of = [&](const HardShadowDraw& draw) {
    return receiver.opacity > 0.0F ? std::min(1.0F, draw.opacity / receiver.opacity) : 0.0F;
  };
  std::set<std::pair<int, float>> kinds;
  for (const HardShadowDraw& draw : plan.hard_shadows) {
    if (draw.plane == receiver.plane) kinds.emplace(draw.light, strength_of(draw));
  }
  const bool apart = kinds.size() <= kMaxHardLights;  // else a light's strongest caster counts
  std::vector<Blocked> lights;
  std::vector<std::vector<const Shadow*>> shadows;  // of each of them
  std::set<Key> seen;
  for (const HardShadowDraw& draw : plan.hard_shadows) {
    if (draw.plane != receiver.plane) continue;
    const Key key = {draw.object, draw.plane, draw.light};
    const Shadow& shadow = shadows_.at(key);
    if (shadow.count == 0 || !seen.insert(key).second) continue;
    const float strength = strength_of(draw);
    const auto found = std::ranges::find_if(lights, [&](const Blocked& known) {
      return known.light == draw.light && (!apart || known.strength == strength);
    });
    const auto at = static_cast<std::size_t>(found - lights.begin());
    if (found == lights.end()) {
      PENUMBRA_ASSERT(lights.size() < kMaxHardLights);
      lights.push_back({draw.light, strength, shadow.low, shadow.high});
      shadows.emplace_back();
    }
    lights[at].strength = std::max(lights[at].strength, strength);
    lights[at].low = lights[at].low.cwiseMin(shadow.low);
    lights[at].high = lights[at].high.cwiseMax(shadow.high);
    shadows[at].push_back(&shadow);
  }
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
    for (const Shadow* shadow : shadows[i]) {
      shadow->layout.bind();
      glDrawArrays(GL_TRIANGLES, 0, shadow->count);
      ++calls;
    }
  }

  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glStencilMask(0);
  glStencilOp(GL_KEEP, GL_KEEP, GL_KEEP);
  glDisable(GL_DEPTH_TEST);
  begin_darkening(context.mode);
  const ShaderProgram& p = light_program_.get();
  p.use();
  p.set("picture_before", kPictureBeforeUnit);
  p.set("table_from_camera", to_gl(plan.T_table_camera.rotation().toRotationMatrix()));
  p.set("eye", to_gl(plan.T_table_camera.translation()));
  p.set("normal", to_gl(receiver.frame.n));
  p.set("opacity", receiver.opacity);
  const unsigned all = (1U << lights.size()) - 1U;
  std::vector<float> blocked(plan.lights.size());
  for (unsigned set = 1; set <= all; ++set) {
    // Of lights whose shadows can't meet there is no pixel.
    std::fill(blocked.begin(), blocked.end(), 0.0F);
    Eigen::Vector2d low = Eigen::Vector2d::Constant(-std::numeric_limits<double>::infinity());
    Eigen::Vector2d high = -low;
    for (std::size_t i = 0; i < lights.size(); ++i) {
      if ((set >> i & 1U) == 0) continue;
      float& of_light = blocked[static_cast<std::size_t>(lights[i].light)];
      of_light = std::max(of_light, lights[i].strength);
      low = low.cwiseMax(lights[i].low);
      high = high.cwiseMin(lights[i].high);
    }
    if ((low.array() > high.array()).any()) continue;
    set_light_uniforms(p, plan, blocked);
    receivers.stencil_test(set, all);
    receivers.draw_grid(p, plan, receiver.frame, lens);
    ++calls;
  }
  return calls;
}

int HardPass::draw(const DrawContext& context, const FramePlan& plan) {
  if (plan.hard_shadows.empty()) return 0;
  // No pixel is of two planes: one copy is right for all.
  if (context.mode == Translucency::retexture) context.framebuffer.copy_picture(kPictureBeforeUnit);
  int calls = 0;
  for (const PlaneReceiver& receiver : plan.receivers) {
    calls += draw_plane(context, plan, receiver);
  }
  glStencilMask(0xFF);
  glDisable(GL_STENCIL_TEST);
  end_translucent();
  glDepthMask(GL_TRUE);
  return calls;
}

}  // namespace penumbra
