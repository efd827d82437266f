#include "render/passes/volume_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <glm/vec4.hpp>
#include <set>

#include "render/passes/lens_uniforms.hpp"
#include "render/passes/receivers.hpp"

namespace penumbra {
namespace {

constexpr unsigned kCountBits = 0x3FU;  // how often the ray has entered a volume, modulo 64
constexpr unsigned kDarkBit = 0x40U;    // in some caster's shadow
// Shows the caster itself, which has no shadow on itself; or the receivers that are darkened now.
constexpr unsigned kMarkBit = 0x80U;

bool same(const Placement& a, const Placement& b) {
  return a.position == b.position && a.rotation.coeffs() == b.rotation.coeffs() &&
         a.scale == b.scale;
}
bool same(const std::vector<PlaneFrame>& a, const std::vector<PlaneFrame>& b) {
  return std::ranges::equal(
      a, b, [](const PlaneFrame& p, const PlaneFrame& q) { return p.n == q.n && p.q == q.q; });
}

// Some pixel may be darkened less than another: what casts or what receives is fainter there.
bool differ_in_opacity(const FramePlan& plan) {
  const auto other = [&](float opacity) { return opacity != plan.overlay_opacity; };
  return std::ranges::any_of(plan.volumes, other, &ShadowVolumeDraw::opacity) ||
         std::ranges::any_of(plan.receivers, other, &PlaneReceiver::opacity) ||
         std::ranges::any_of(plan.objects, other, &ObjectDraw::opacity) ||
         std::ranges::any_of(plan.phantoms, other, &ObjectDraw::opacity);
}

}  // namespace

Result<VolumePass> VolumePass::create(GlApi api, const CameraModel& camera) {
  constexpr std::array<std::string_view, 2> kVertex = {"lens.glsl", "volume.vert.glsl"};
  constexpr std::array<std::string_view, 1> kNothing = {"outline.frag.glsl"};
  constexpr std::array<std::string_view, 1> kWhole = {"video.vert.glsl"};
  constexpr std::array<std::string_view, 1> kFill = {"fill.frag.glsl"};
  constexpr std::array<std::string_view, 1> kSum = {"light_sum.frag.glsl"};
  auto volume = ShaderProgram::link(api, kVertex, kNothing);
  if (!volume) return tl::unexpected(volume.error());
  auto fill = ShaderProgram::link(api, kWhole, kFill);
  if (!fill) return tl::unexpected(fill.error());
  auto light_sum = ShaderProgram::link(api, kWhole, kSum);
  if (!light_sum) return tl::unexpected(light_sum.error());
  VolumePass pass(std::move(*volume), std::move(*fill), std::move(*light_sum));
  if (make_lens(camera).model != 0) pass.longest_edge_ = longest_edge(camera);
  return pass;
}

void VolumePass::prepare(const Scene& scene, const FramePlan& plan, ShadowWork& work) {
  for (const ShadowVolumeDraw& draw : plan.volumes) {
    Volume& volume = volumes_[{draw.object, draw.light}];
    if (volume.valid && same(volume.T_table_object, draw.T_table_object) &&
        volume.light == draw.light_place && same(volume.floors, draw.floors)) {
      ++work.reprojections;
      continue;
    }
    ++work.recomputed;
    const Model* model = scene.objects[static_cast<std::size_t>(draw.object)].model.get();
    auto& caster = casters_[model];
    if (!caster) caster = std::make_unique<VolumeCaster>(make_shadow_mesh(*model));
    ShadowVolume made =
        caster->volume(draw.T_table_object, draw.light_place, draw.floors, draw.reach);
    if (made.light_inside) ++work.layers_skipped;
    if (longest_edge_) {
      made.triangles = split_for_lens(made.triangles, *longest_edge_);
    }
    work.vertices += static_cast<std::int64_t>(made.triangles.size());
    volume.valid = true;
    volume.T_table_object = draw.T_table_object;
    volume.light = draw.light_place;
    volume.floors = draw.floors;
    volume.count = static_cast<int>(made.triangles.size());
    volume.layout.bind();
    volume.vertices.write(std::span<const glm::vec3>(made.triangles), BufferLife::every_frame);
    if (!volume.layout_made) {
      VertexArray::attribute(0, 3, sizeof(glm::vec3), 0);
      volume.layout_made = true;
    }
  }
}

int VolumePass::count(const Scene& scene, const FramePlan& plan, const ShadowVolumeDraw& draw,
                      const LensUniforms& lens, const ObjectPass& objects) const {
  // Where the caster itself is seen.
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDisable(GL_BLEND);
  glEnable(GL_DEPTH_TEST);
  glStencilMask(kMarkBit);
  glStencilFunc(GL_ALWAYS, static_cast<GLint>(kMarkBit), kMarkBit);
  glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
  glDepthFunc(GL_EQUAL);
  const int calls = objects.draw_alone(scene, {draw.object, draw.T_table_object, 1.0F}, plan, lens);
  // How many of the volume's walls are behind what the pixel shows: those turned to the eye count
  // one way, those turned away the other.
  volume_program_.use();
  set_lens(volume_program_, lens);
  volume_program_.set("camera_from_table", camera_from_object(plan.T_table_camera, Placement()));
  glDepthFunc(GL_LESS);
  glStencilMask(kCountBits);
  glStencilFunc(GL_EQUAL, 0, kMarkBit);
  glStencilOpSeparate(GL_FRONT, GL_KEEP, GL_DECR_WRAP, GL_KEEP);
  glStencilOpSeparate(GL_BACK, GL_KEEP, GL_INCR_WRAP, GL_KEEP);
  const Volume& volume = volumes_.at({draw.object, draw.light});
  volume.layout.bind();
  glDrawArrays(GL_TRIANGLES, 0, volume.count);
  glDisable(GL_DEPTH_TEST);
  glStencilMask(kMarkBit);
  glClear(GL_STENCIL_BUFFER_BIT);
  return calls + 1;
}

// The pixels that the stencil lets through: the picture, or where several lights add up, the sums.
void VolumePass::darken(const Eigen::Vector3d& light_left, float opacity, bool add_up) const {
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDisable(GL_DEPTH_TEST);
  glEnable(GL_BLEND);
  glStencilOp(GL_KEEP, GL_KEEP, GL_KEEP);
  fill_program_.use();
  glm::vec4 value(1.0F);
  if (add_up) {
    glBlendFunc(GL_ONE, GL_ONE);
    glBlendEquationSeparate(GL_FUNC_ADD, GL_MAX);
    value = opacity * glm::vec4(1.0F - to_gl(light_left), 1.0F);
  } else {
    glBlendFunc(GL_ZERO, GL_SRC_COLOR);
    for (glm::length_t i = 0; i < 3; ++i) {
      const double share = light_left[i];
      value[i] = static_cast<float>(1.0 - static_cast<double>(opacity) *
                                              (1.0 - std::pow(share, 1.0 / 2.2)));
    }
  }
  fill_program_.set("value", value);
  no_vertices_.bind();
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glBlendEquation(GL_FUNC_ADD);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDisable(GL_BLEND);
}

void VolumePass::darken_by_sums(const Framebuffer& framebuffer) const {
  framebuffer.bind();
  framebuffer.bind_sums_texture(0);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  glEnable(GL_BLEND);
  glBlendFunc(GL_ZERO, GL_SRC_COLOR);
  light_sum_program_.use();
  light_sum_program_.set("sums", 0);
  no_vertices_.bind();
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

int VolumePass::draw_light(const Scene& scene, const FramePlan& plan, const Casters& casters,
                           const LensUniforms& lens, const ObjectPass& objects,
                           const Receivers& receivers, bool add_up) const {
  glStencilMask(0xFF);
  glClear(GL_STENCIL_BUFFER_BIT);
  if (differ_in_opacity(plan)) {
    return draw_faint(scene, plan, casters, lens, objects, receivers, add_up);
  }
  int calls = 0;
  for (const ShadowVolumeDraw* caster : casters) {
    calls += count(scene, plan, *caster, lens, objects) + 1;
    note_dark();
  }
  glStencilMask(0);
  glStencilFunc(GL_EQUAL, static_cast<GLint>(kDarkBit), kDarkBit);
  darken(casters.front()->light_left, plan.overlay_opacity, add_up);
  return calls + 1;
}

int VolumePass::draw(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
                     const ObjectPass& objects, const Receivers& receivers,
                     Framebuffer& framebuffer) const {
  std::vector<Casters> lights;
  for (const ShadowVolumeDraw& draw : plan.volumes) {
    if (volumes_.at({draw.object, draw.light}).count == 0) continue;
    const auto known = std::ranges::find_if(
        lights, [&draw](const Casters& casters) { return casters.front()->light == draw.light; });
    (known == lights.end() ? lights.emplace_back() : *known).push_back(&draw);
  }
  if (lights.empty()) return 0;
  const bool add_up = lights.size() > 1;
  if (add_up) framebuffer.bind_sums();
  int calls = 0;
  glEnable(GL_STENCIL_TEST);
  glDepthMask(GL_FALSE);
  for (const Casters& casters : lights) {
    calls += draw_light(scene, plan, casters, lens, objects, receivers, add_up);
  }
  if (add_up) {
    darken_by_sums(framebuffer);
    ++calls;
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glStencilMask(0xFF);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  glDepthMask(GL_TRUE);
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

// Caster by caster, the strongest first, and each of them on what is equally strong together: a
// pixel in the shadow of several is darkened once, by the first.
int VolumePass::draw_faint(const Scene& scene, const FramePlan& plan, Casters casters,
                           const LensUniforms& lens, const ObjectPass& objects,
                           const Receivers& receivers, bool add_up) const {
  std::ranges::stable_sort(casters, std::greater<>(),
                           [](const ShadowVolumeDraw* draw) { return draw->opacity; });
  std::set<float> opacities;
  for (const PlaneReceiver& receiver : plan.receivers) opacities.insert(receiver.opacity);
  for (const ObjectDraw& object : plan.objects) opacities.insert(object.opacity);
  for (const ObjectDraw& phantom : plan.phantoms) opacities.insert(phantom.opacity);
  int calls = 0;
  for (const ShadowVolumeDraw* caster : casters) {
    calls += count(scene, plan, *caster, lens, objects);
    // What is dark already counts no more.
    fill_program_.use();
    no_vertices_.bind();
    glStencilMask(kCountBits);
    glStencilFunc(GL_EQUAL, static_cast<GLint>(kDarkBit), kDarkBit);
    glStencilOp(GL_KEEP, GL_KEEP, GL_ZERO);
    glDrawArrays(GL_TRIANGLES, 0, 3);
    for (const float opacity : opacities) {
      // What shows a receiver of this opacity: its own depth is there.
      glEnable(GL_DEPTH_TEST);
      glDepthFunc(GL_EQUAL);
      glStencilMask(kMarkBit);
      glStencilFunc(GL_ALWAYS, static_cast<GLint>(kMarkBit), kMarkBit);
      glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
      for (const std::vector<ObjectDraw>* things : {&plan.objects, &plan.phantoms}) {
        for (const ObjectDraw& thing : *things) {
          if (thing.opacity == opacity) calls += objects.draw_alone(scene, thing, plan, lens);
        }
      }
      for (const PlaneReceiver& receiver : plan.receivers) {
        if (receiver.opacity != opacity) continue;
        receivers.draw_place(plan, receiver.frame, lens);
        ++calls;
      }
      glStencilMask(0);
      glStencilFunc(GL_LESS, static_cast<GLint>(kMarkBit), kMarkBit | kCountBits);
      darken(caster->light_left, std::min(opacity, caster->opacity), add_up);
      glStencilMask(kMarkBit);
      glClear(GL_STENCIL_BUFFER_BIT);
      ++calls;
    }
    note_dark();
    calls += 2;
  }
  return calls;
}

}  // namespace penumbra
