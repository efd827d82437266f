#include "render/passes/volume_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "core/propagate.hpp"
#include "render/passes/uniforms.hpp"

namespace penumbra {
namespace {

constexpr unsigned kCountBits = kMaxVolumesCounted;  // how often a pixel's ray enters the volume
constexpr unsigned kDarkBit = 0x40U;                 // the pixel is in some caster's shadow
// The pixel shows the caster, which does not shadow itself, or the plane being darkened.
constexpr unsigned kMarkBit = 0x80U;
static_assert((kCountBits & (kDarkBit | kMarkBit)) == 0);

// Returns the volume's triangles, split to `longest_edge` [m] if given, and the end of each batch.
std::pair<std::vector<glm::vec3>, std::vector<int>> split_batches(
    const ShadowVolume& volume, std::optional<double> longest_edge) {
  std::vector<glm::vec3> triangles;
  std::vector<int> batch_ends;
  std::size_t begin = 0;
  for (const std::size_t end : volume.batch_ends) {
    std::vector<glm::vec3> batch(volume.triangles.begin() + static_cast<std::ptrdiff_t>(begin),
                                 volume.triangles.begin() + static_cast<std::ptrdiff_t>(end));
    if (longest_edge) {
      // The batch's proportion of all triangles.
      const auto budget = static_cast<std::size_t>(
          std::ceil(static_cast<double>(kMaxVolumeTriangles) * static_cast<double>(batch.size()) /
                    static_cast<double>(volume.triangles.size())));
      batch = split_for_lens(std::move(batch), *longest_edge, budget);
    }
    triangles.insert(triangles.end(), batch.begin(), batch.end());
    batch_ends.push_back(static_cast<int>(triangles.size()));
    begin = end;
  }
  return {std::move(triangles), std::move(batch_ends)};
}

// Returns true if the two draws have the same volume.
bool same_volume(const ShadowVolumeDraw& a, const ShadowVolumeDraw& b) {
  return a.T_table_object == b.T_table_object && a.pose_s == b.pose_s &&
         a.light_position == b.light_position && a.floors == b.floors && a.receivers == b.receivers;
}

}  // namespace

Result<std::unique_ptr<VolumePass>> VolumePass::create(GlApi api, const CameraModel& camera) {
  auto pass = std::make_unique<VolumePass>();
  PENUMBRA_TRY(pass->volume_program_,
               ShaderProgram::link(api, {"lens.glsl", "volume.vert.glsl"}, {"fill.frag.glsl"}));
  PENUMBRA_TRY(pass->fill_program_,
               ShaderProgram::link(api, {"video.vert.glsl"}, {"fill.frag.glsl"}));
  PENUMBRA_TRY(pass->plane_program_, plane_light_program(api));
  PENUMBRA_TRY(pass->light_sum_program_,
               TranslucentProgram::create(api, {"video.vert.glsl"}, {"light_sum.frag.glsl"}));
  if (camera.has_distortion()) pass->longest_edge_ = longest_edge(camera);
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
    if (plan.reuse && volume.made_for && same_volume(*volume.made_for, draw)) {
      ++work[Counter::reprojections];
      report_problems(draw, volume, work);
      continue;
    }
    ++work[Counter::triples_recomputed];
    const VolumeCaster& caster =
        casters_.of(scene, draw.object, draw.proxy,
                    [](const Model& model) { return VolumeCaster(make_shadow_mesh(model)); });
    const ShadowVolume made = caster.volume(draw.T_table_object, draw.light_position, draw.floors,
                                            kVolumeReach, draw.receivers);
    volume.made_for = draw;
    volume.light_inside = made.light_inside;
    volume.ends_above_floors = made.ends_above_floors;
    report_problems(draw, volume, work);
    auto [triangles, batch_ends] = split_batches(made, longest_edge_);
    work[Counter::shadow_vertices] += static_cast<std::int64_t>(triangles.size());
    volume.surface.write(triangles, BufferLife::every_frame);
    volume.batch_ends = std::move(batch_ends);
  }
  return {};
}

void VolumePass::report_problems(const ShadowVolumeDraw& draw, const Volume& volume,
                                 RenderWork& work) {
  if (volume.light_inside)
    work.skipped.push_back({SkipReason::light_inside_caster, draw.object, draw.light});
  if (volume.ends_above_floors)
    work.skipped.push_back({SkipReason::volume_too_far, draw.object, draw.light});
}

int VolumePass::mark_caster(const Drawing& drawing, const ShadowVolumeDraw& draw) const {
  const auto& [plan, lens, objects, receivers] = drawing;
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDisable(GL_BLEND);
  glEnable(GL_DEPTH_TEST);
  glStencilMask(kMarkBit);
  glStencilFunc(GL_ALWAYS, static_cast<GLint>(kMarkBit), kMarkBit);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  glDepthFunc(GL_EQUAL);
  return objects.draw_alone({draw.object, draw.T_table_object, 1.0F}, plan, lens);
}

void VolumePass::clear_mark() {
  glStencilMask(kMarkBit);
  glClear(GL_STENCIL_BUFFER_BIT);
}

void VolumePass::count(const Drawing& drawing, const ShadowVolumeDraw& draw,
                       std::size_t batch) const {
  const Volume& volume = volumes_.at({draw.object, draw.light});
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDisable(GL_BLEND);
  glEnable(GL_DEPTH_TEST);
  volume_program_.use();
  set_lens(volume_program_, drawing.lens);
  volume_program_.set("camera_from_table",
                      camera_from_object(drawing.plan.T_table_camera, Placement()));
  glDepthFunc(GL_LESS);
  glStencilMask(kCountBits);
  glStencilFunc(GL_EQUAL, 0, kMarkBit);
  glStencilOpSeparate(GL_FRONT, GL_KEEP, GL_DECR_WRAP, GL_KEEP);
  glStencilOpSeparate(GL_BACK, GL_KEEP, GL_INCR_WRAP, GL_KEEP);
  const int begin = batch == 0 ? 0 : volume.batch_ends[batch - 1];
  volume.surface.draw(GL_TRIANGLES, begin, volume.batch_ends[batch] - begin);
  glDisable(GL_DEPTH_TEST);
}

int VolumePass::mark_volume(const Drawing& drawing, const ShadowVolumeDraw& draw) const {
  int calls = mark_caster(drawing, draw);
  const std::size_t batches = volumes_.at({draw.object, draw.light}).batch_ends.size();
  for (std::size_t batch = 0; batch < batches; ++batch) {
    count(drawing, draw, batch);
    mark_dark();
    calls += 2;
  }
  clear_mark();
  return calls;
}

// Marks pixels with a non-zero count as dark, and resets the count.
void VolumePass::mark_dark() const {
  fill_program_.use();
  glStencilMask(kCountBits | kDarkBit);
  glStencilFunc(GL_NOTEQUAL, static_cast<GLint>(kDarkBit), kCountBits);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  no_vertices_.bind();
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

// Darkened pixels get the stencil `how.after`; coincident surfaces do not darken them again.
int VolumePass::darken(const Drawing& drawing, const ShadowVolumeDraw& draw,
                       const Darkening& how) const {
  const auto& [plan, lens, objects, receivers] = drawing;
  int calls = draw.on_planes ? darken_planes(drawing, draw.light, how) : 0;
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  begin_translucent(mode_, how.add_up ? Blending::sum : Blending::darken);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_EQUAL);
  glStencilMask(how.written);
  glStencilFunc(GL_NOTEQUAL, static_cast<GLint>(how.after), how.tested);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  const auto darken_each = [&](const std::vector<ObjectDraw>& surfaces) {
    for (const ObjectDraw& surface : surfaces) {
      calls += objects.draw_darkened(surface, plan, lens, draw.light,
                                     std::min(surface.opacity, how.strength), how.add_up);
    }
  };
  darken_each(plan.phantoms);
  if (draw.on_planes) darken_each(plan.objects);
  end_translucent();
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDisable(GL_DEPTH_TEST);
  return calls;
}

int VolumePass::darken_planes(const Drawing& drawing, int light, const Darkening& how) const {
  const auto& [plan, lens, objects, receivers] = drawing;
  int calls = 0;
  std::vector<float> blocked(plan.lights.size(), 0.0F);
  blocked.at(static_cast<std::size_t>(light)) = 1.0F;
  for (const PlaneReceiver& receiver : plan.receivers) {
    // Marks the dark pixels with the plane's depth.
    glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
    glDisable(GL_BLEND);
    glEnable(GL_DEPTH_TEST);
    glDepthFunc(GL_EQUAL);
    glStencilMask(kMarkBit);
    glStencilFunc(GL_NOTEQUAL, static_cast<GLint>(kMarkBit), how.tested);
    glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
    receivers.draw_depth(plan, receiver.frame, lens);
    glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
    begin_translucent(mode_, how.add_up ? Blending::sum : Blending::darken);
    glDisable(GL_DEPTH_TEST);
    glStencilMask(kMarkBit | how.written);
    glStencilFunc(GL_NOTEQUAL, static_cast<GLint>(how.after), kMarkBit);
    const ShaderProgram& p = plane_program_.get();
    begin_plane_light(p, plan, receiver.frame, std::min(receiver.opacity, how.strength));
    p.set("add_up", how.add_up ? 1 : 0);
    set_lights(p, plan, blocked);
    receivers.draw_grid(p, plan, receiver.frame, lens);
    end_translucent();
    calls += 2;
  }
  return calls;
}

void VolumePass::darken_by_sums(const FramePlan& plan, Framebuffer& framebuffer) const {
  framebuffer.bind();
  if (mode_ == Translucency::retexture) framebuffer.copy_image(kFramebufferCopyUnit);
  framebuffer.bind_sums_texture(0);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  begin_translucent(mode_, Blending::darken);
  const ShaderProgram& p = light_sum_program_.get();
  p.use();
  p.set("sums", 0);
  p.set("encoding", static_cast<float>(1.0 / plan.tone_exponent));
  no_vertices_.bind();
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

// Draws all casters together if their opacities are equal, else one by one, highest opacity first.
// A pixel in several shadows is darkened once, by the first.
int VolumePass::draw_light(const Drawing& drawing, Casters casters, bool add_up) const {
  glStencilMask(0xFF);
  glClear(GL_STENCIL_BUFFER_BIT);
  std::ranges::stable_sort(casters, std::greater<>(),
                           [](const ShadowVolumeDraw* draw) { return draw->opacity; });
  int calls = 0;
  if (casters.front()->opacity == casters.back()->opacity) {
    for (const ShadowVolumeDraw* caster : casters) calls += mark_volume(drawing, *caster);
    return calls + darken(drawing, *casters.front(),
                          {kDarkBit, 0, kDarkBit, casters.front()->opacity, add_up});
  }
  for (const ShadowVolumeDraw* caster : casters) {
    const std::size_t batches = volumes_.at({caster->object, caster->light}).batch_ends.size();
    for (std::size_t batch = 0; batch < batches; ++batch) {
      calls += mark_caster(drawing, *caster) + 1;
      count(drawing, *caster, batch);
      clear_mark();
      // Excludes pixels that are already dark.
      fill_program_.use();
      no_vertices_.bind();
      glStencilMask(kCountBits);
      glStencilFunc(GL_EQUAL, static_cast<GLint>(kDarkBit), kDarkBit);
      glStencilOp(GL_KEEP, GL_KEEP, GL_ZERO);
      glDrawArrays(GL_TRIANGLES, 0, 3);
      calls += darken(drawing, *caster,
                      {kCountBits, kDarkBit, kCountBits | kDarkBit, caster->opacity, add_up});
      mark_dark();
      calls += 2;
    }
  }
  return calls;
}

int VolumePass::draw(const DrawContext& context, const FramePlan& plan) {
  Framebuffer& framebuffer = context.framebuffer;
  std::vector<Casters> lights;
  for (const ShadowVolumeDraw& draw : plan.volumes) {
    if (volumes_.at({draw.object, draw.light}).batch_ends.size() == 0) continue;
    const auto known = std::ranges::find_if(
        lights, [&draw](const Casters& casters) { return casters.front()->light == draw.light; });
    (known == lights.end() ? lights.emplace_back() : *known).push_back(&draw);
  }
  if (lights.empty()) return 0;
  // Also counts lights out of view, so that culling does not change the rounding of sums.
  const bool add_up = plan.volume_lights > 1;
  if (add_up) framebuffer.bind_sums();
  const Drawing drawing{plan, context.lens, context.objects, context.receivers};
  int calls = 0;
  glEnable(GL_STENCIL_TEST);
  glDepthMask(GL_FALSE);
  for (const Casters& casters : lights) {
    // A light darkens a pixel once, so one copy per light is enough.
    if (add_up && mode_ != Translucency::blend) {
      framebuffer.copy_sums(kSumsCopyUnit);
    } else if (!add_up && mode_ == Translucency::retexture) {
      framebuffer.copy_image(kFramebufferCopyUnit);
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
