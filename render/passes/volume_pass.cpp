#include "render/passes/volume_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <span>

#include "core/propagate.hpp"
#include "render/passes/lens_uniforms.hpp"
#include "render/passes/light_uniforms.hpp"
#include "render/passes/receivers.hpp"

namespace penumbra {
namespace {

constexpr unsigned kCountBits = kMostVolumesCounted;  // how often the ray has entered a volume
constexpr unsigned kDarkBit = 0x40U;                  // in some caster's shadow
// Shows the caster itself, which has no shadow on itself; or the plane that is darkened now.
constexpr unsigned kMarkBit = 0x80U;
static_assert((kCountBits & (kDarkBit | kMarkBit)) == 0);

}  // namespace

Result<std::unique_ptr<VolumePass>> VolumePass::create(GlApi api, const CameraModel& camera) {
  constexpr std::array<std::string_view, 1> kWhole = {"video.vert.glsl"};
  constexpr std::array<std::string_view, 1> kFill = {"fill.frag.glsl"};
  constexpr std::array<std::string_view, 2> kReceiver = {"lens.glsl", "receiver.vert.glsl"};
  constexpr std::array<std::string_view, 3> kLight = {"ambient.glsl", "light_share.glsl",
                                                      "blocked_light.frag.glsl"};
  constexpr std::array<std::string_view, 1> kSum = {"light_sum.frag.glsl"};
  PENUMBRA_TRY(auto volume, volume_program(api));
  PENUMBRA_TRY(auto fill, ShaderProgram::link(api, kWhole, kFill));
  PENUMBRA_TRY(auto plane, TranslucentProgram::create(api, kReceiver, kLight, kLightDefines));
  PENUMBRA_TRY(auto light_sum, TranslucentProgram::create(api, kWhole, kSum));
  std::unique_ptr<VolumePass> pass(
      new VolumePass(std::move(volume), std::move(fill), std::move(plane), std::move(light_sum)));
  if (make_lens(camera).model != 0) pass->longest_edge_ = longest_edge(camera);
  return pass;
}

Result<void> VolumePass::prepare(const DrawContext& context, const FramePlan& plan) {
  mode_ = context.mode;
  PENUMBRA_TRY_VOID(plane_program_.choose(mode_, context.video_format));
  PENUMBRA_TRY_VOID(light_sum_program_.choose(mode_, context.video_format));
  const Scene& scene = context.scene;
  RenderWork& work = context.work;
  for (const ShadowVolumeDraw& draw : plan.volumes) {
    Volume& volume = volumes_[{draw.object, draw.light}];
    if (plan.reuse && volume.valid && volume.T_table_object == draw.T_table_object &&
        volume.light == draw.light_place && volume.floors == draw.floors &&
        volume.receivers == draw.receivers) {
      ++work[Counter::reprojections];
      note_trouble(draw, volume, work);
      continue;
    }
    ++work[Counter::triples_recomputed];
    const SceneObject& object = scene.objects[static_cast<std::size_t>(draw.object)];
    const Model* model = casting_model(object, draw.proxy).get();
    auto& caster = casters_[model];
    if (!caster) caster = std::make_unique<VolumeCaster>(make_shadow_mesh(*model));
    ShadowVolume made = caster->volume(draw.T_table_object, draw.light_place, draw.floors,
                                       draw.reach, draw.receivers);
    volume.light_inside = made.light_inside;
    volume.ends_above_floors = made.ends_above_floors;
    note_trouble(draw, volume, work);
    work[Counter::shadow_vertices] +=
        static_cast<std::int64_t>(volume.buffers.write(made, longest_edge_));
    volume.valid = true;
    volume.T_table_object = draw.T_table_object;
    volume.light = draw.light_place;
    volume.floors = draw.floors;
    volume.receivers = draw.receivers;
  }
  return {};
}

void VolumePass::note_trouble(const ShadowVolumeDraw& draw, const Volume& volume,
                              RenderWork& work) {
  if (volume.light_inside)
    work.skipped.push_back({SkipReason::light_inside_caster, draw.object, draw.light});
  if (volume.ends_above_floors)
    work.skipped.push_back({SkipReason::volume_too_far, draw.object, draw.light});
}

// Where the caster itself is seen.
int VolumePass::mark_caster(const Drawing& drawing, const ShadowVolumeDraw& draw) const {
  const auto& [scene, plan, lens, objects, receivers] = drawing;
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDisable(GL_BLEND);
  glEnable(GL_DEPTH_TEST);
  glStencilMask(kMarkBit);
  glStencilFunc(GL_ALWAYS, static_cast<GLint>(kMarkBit), kMarkBit);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  glDepthFunc(GL_EQUAL);
  return objects.draw_alone(scene, {draw.object, draw.T_table_object, 1.0F}, plan, lens);
}

void VolumePass::clear_mark() {
  glStencilMask(kMarkBit);
  glClear(GL_STENCIL_BUFFER_BIT);
}

// Not where the pixel is marked.
void VolumePass::count(const Drawing& drawing, const ShadowVolumeDraw& draw,
                       std::size_t batch) const {
  count_volume(volume_program_, drawing.lens,
               camera_from_object(drawing.plan.T_table_camera, Placement()),
               volumes_.at({draw.object, draw.light}).buffers, batch, kMarkBit);
}

int VolumePass::note_volume(const Drawing& drawing, const ShadowVolumeDraw& draw) const {
  int calls = mark_caster(drawing, draw);
  const std::size_t batches = volumes_.at({draw.object, draw.light}).buffers.batches();
  for (std::size_t batch = 0; batch < batches; ++batch) {
    count(drawing, draw, batch);
    note_dark();
    calls += 2;
  }
  clear_mark();
  return calls;
}

// Any count but 0 -> dark, and 0 again.
void VolumePass::note_dark() const {
  fill_program_.use();
  glStencilMask(kCountBits | kDarkBit);
  glStencilFunc(GL_NOTEQUAL, static_cast<GLint>(kDarkBit), kCountBits);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  no_vertices_.bind();
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

// A pixel's stencil is `how.after` once it is darkened: nothing that lies in the same place, as a
// second plane or a face given twice, darkens it again.
int VolumePass::darken(const Drawing& drawing, const ShadowVolumeDraw& draw,
                       const Darkening& how) const {
  const auto& [scene, plan, lens, objects, receivers] = drawing;
  int calls = draw.on_planes ? darken_planes(drawing, draw.light, how) : 0;
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  begin(how);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_EQUAL);
  glStencilMask(how.written);
  glStencilFunc(GL_NOTEQUAL, static_cast<GLint>(how.after), how.tested);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  const auto darken_things = [&](const std::vector<ObjectDraw>& things) {
    for (const ObjectDraw& thing : things) {
      calls += objects.draw_darkened(scene, thing, plan, lens, draw.light,
                                     std::min(thing.opacity, how.strength), how.add_up);
    }
  };
  darken_things(plan.phantoms);
  if (draw.on_planes) darken_things(plan.objects);
  end_translucent();
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDisable(GL_DEPTH_TEST);
  return calls;
}

void VolumePass::begin(const Darkening& how) const {
  if (how.add_up) {
    begin_summing(mode_);
  } else {
    begin_darkening(mode_);
  }
}

int VolumePass::darken_planes(const Drawing& drawing, int light, const Darkening& how) const {
  const auto& [scene, plan, lens, objects, receivers] = drawing;
  int calls = 0;
  std::vector<float> blocked(plan.lights.size(), 0.0F);
  blocked.at(static_cast<std::size_t>(light)) = 1.0F;
  for (const PlaneReceiver& receiver : plan.receivers) {
    // The dark pixels that show it: its own depth is there.
    glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
    glDisable(GL_BLEND);
    glEnable(GL_DEPTH_TEST);
    glDepthFunc(GL_EQUAL);
    glStencilMask(kMarkBit);
    glStencilFunc(GL_NOTEQUAL, static_cast<GLint>(kMarkBit), how.tested);
    glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
    receivers.draw_place(plan, receiver.frame, lens);
    glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
    begin(how);
    glDisable(GL_DEPTH_TEST);
    glStencilMask(kMarkBit | how.written);
    glStencilFunc(GL_NOTEQUAL, static_cast<GLint>(how.after), kMarkBit);
    const ShaderProgram& p = plane_program_.get();
    p.use();
    p.set("picture_before", kPictureBeforeUnit);
    p.set("sums_before", kSumsBeforeUnit);
    p.set("table_from_camera", to_gl(plan.T_table_camera.rotation().toRotationMatrix()));
    p.set("eye", to_gl(plan.T_table_camera.translation()));
    p.set("normal", to_gl(receiver.frame.n));
    p.set("opacity", std::min(receiver.opacity, how.strength));
    p.set("add_up", how.add_up ? 1 : 0);
    set_light_uniforms(p, plan, blocked);
    receivers.draw_grid(p, plan, receiver.frame, lens);
    end_translucent();
    calls += 2;
  }
  return calls;
}

void VolumePass::darken_by_sums(const FramePlan& plan, Framebuffer& framebuffer) const {
  framebuffer.bind();
  if (mode_ == Translucency::retexture) framebuffer.copy_picture(kPictureBeforeUnit);
  framebuffer.bind_sums_texture(0);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  begin_darkening(mode_);
  const ShaderProgram& p = light_sum_program_.get();
  p.use();
  p.set("sums", 0);
  p.set("encoding", static_cast<float>(1.0 / plan.tone_exponent));
  p.set("picture_before", kPictureBeforeUnit);
  no_vertices_.bind();
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

// Casters that are equally strong together. Of others one by one, the strongest first: a pixel in
// the shadow of several is darkened once, by the first.
int VolumePass::draw_light(const Drawing& drawing, Casters casters, bool add_up) const {
  glStencilMask(0xFF);
  glClear(GL_STENCIL_BUFFER_BIT);
  std::ranges::stable_sort(casters, std::greater<>(),
                           [](const ShadowVolumeDraw* draw) { return draw->opacity; });
  int calls = 0;
  if (casters.front()->opacity == casters.back()->opacity) {
    for (const ShadowVolumeDraw* caster : casters) calls += note_volume(drawing, *caster);
    return calls + darken(drawing, *casters.front(),
                          {kDarkBit, 0, kDarkBit, casters.front()->opacity, add_up});
  }
  for (const ShadowVolumeDraw* caster : casters) {
    const std::size_t batches = volumes_.at({caster->object, caster->light}).buffers.batches();
    for (std::size_t batch = 0; batch < batches; ++batch) {
      calls += mark_caster(drawing, *caster) + 1;
      count(drawing, *caster, batch);
      clear_mark();
      // What is dark already counts no more.
      fill_program_.use();
      no_vertices_.bind();
      glStencilMask(kCountBits);
      glStencilFunc(GL_EQUAL, static_cast<GLint>(kDarkBit), kDarkBit);
      glStencilOp(GL_KEEP, GL_KEEP, GL_ZERO);
      glDrawArrays(GL_TRIANGLES, 0, 3);
      calls += darken(drawing, *caster,
                      {kCountBits, kDarkBit, kCountBits | kDarkBit, caster->opacity, add_up});
      note_dark();
      calls += 2;
    }
  }
  return calls;
}

int VolumePass::draw(const DrawContext& context, const FramePlan& plan) {
  Framebuffer& framebuffer = context.framebuffer;
  std::vector<Casters> lights;
  for (const ShadowVolumeDraw& draw : plan.volumes) {
    if (volumes_.at({draw.object, draw.light}).buffers.batches() == 0) continue;
    const auto known = std::ranges::find_if(
        lights, [&draw](const Casters& casters) { return casters.front()->light == draw.light; });
    (known == lights.end() ? lights.emplace_back() : *known).push_back(&draw);
  }
  if (lights.empty()) return 0;
  // Not of those in view: sums are rounded otherwise than one light's share.
  const bool add_up = plan.volume_lights > 1;
  if (add_up) framebuffer.bind_sums();
  const Drawing drawing{context.scene, plan, context.lens, context.objects, context.receivers};
  int calls = 0;
  glEnable(GL_STENCIL_TEST);
  glDepthMask(GL_FALSE);
  for (const Casters& casters : lights) {
    // A light darkens a pixel once: before it is soon enough for a copy.
    if (add_up && mode_ != Translucency::blend) {
      framebuffer.copy_sums(kSumsBeforeUnit);
    } else if (!add_up && mode_ == Translucency::retexture) {
      framebuffer.copy_picture(kPictureBeforeUnit);
    }
    calls += draw_light(drawing, casters, add_up);
  }
  if (add_up) {
    darken_by_sums(plan, framebuffer);
    ++calls;
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glStencilMask(0xFF);
  glDisable(GL_STENCIL_TEST);
  end_translucent();
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  return calls;
}

}  // namespace penumbra
