#include "render/passes/volume_pass.hpp"

#include <epoxy/gl.h>

#include <array>
#include <cmath>

#include "render/passes/lens_uniforms.hpp"
#include "render/passes/receivers.hpp"

namespace penumbra {
namespace {

constexpr unsigned kCountBits = 0x3FU;  // how often the ray has entered a volume, modulo 64
constexpr unsigned kDarkBit = 0x40U;    // in some caster's shadow
constexpr unsigned kCasterBit = 0x80U;  // shows the caster itself, which has no shadow on itself

bool same(const Placement& a, const Placement& b) {
  return a.position == b.position && a.rotation.coeffs() == b.rotation.coeffs() &&
         a.scale == b.scale;
}

}  // namespace

Result<VolumePass> VolumePass::create(GlApi api, const CameraModel& camera) {
  constexpr std::array<std::string_view, 2> kVertex = {"lens.glsl", "volume.vert.glsl"};
  constexpr std::array<std::string_view, 1> kNothing = {"outline.frag.glsl"};
  constexpr std::array<std::string_view, 1> kWhole = {"video.vert.glsl"};
  constexpr std::array<std::string_view, 1> kFill = {"fill.frag.glsl"};
  auto volume = ShaderProgram::link(api, kVertex, kNothing);
  if (!volume) return tl::unexpected(volume.error());
  auto fill = ShaderProgram::link(api, kWhole, kFill);
  if (!fill) return tl::unexpected(fill.error());
  VolumePass pass(std::move(*volume), std::move(*fill));
  if (make_lens(camera).model != 0) pass.longest_edge_ = longest_edge(camera);
  return pass;
}

void VolumePass::prepare(const Scene& scene, const FramePlan& plan, ShadowWork& work) {
  for (const ShadowVolumeDraw& draw : plan.volumes) {
    Volume& volume = volumes_[{draw.object, draw.light}];
    if (volume.valid && same(volume.T_table_object, draw.T_table_object) &&
        volume.light == draw.light_place) {
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
    volume.count = static_cast<int>(made.triangles.size());
    volume.layout.bind();
    volume.vertices.write(std::span<const glm::vec3>(made.triangles), BufferLife::every_frame);
    if (!volume.layout_made) {
      VertexArray::attribute(0, 3, sizeof(glm::vec3), 0);
      volume.layout_made = true;
    }
  }
}

int VolumePass::draw(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
                     const ObjectPass& objects) const {
  if (plan.volumes.empty()) return 0;
  const Placement table;
  int calls = 0;
  glEnable(GL_STENCIL_TEST);
  glStencilMask(0xFF);
  glClear(GL_STENCIL_BUFFER_BIT);
  glDepthMask(GL_FALSE);
  glDisable(GL_BLEND);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  for (const ShadowVolumeDraw& draw : plan.volumes) {
    const Volume& volume = volumes_.at({draw.object, draw.light});
    if (volume.count == 0) continue;
    // Where the caster itself is seen.
    glEnable(GL_DEPTH_TEST);
    glStencilMask(kCasterBit);
    glStencilFunc(GL_ALWAYS, static_cast<GLint>(kCasterBit), kCasterBit);
    glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
    glDepthFunc(GL_EQUAL);
    calls += objects.draw_alone(scene, {draw.object, draw.T_table_object, 1.0F}, plan, lens);
    // How many of the volume's walls are behind what the pixel shows: those turned to the eye count
    // one way, those turned away the other.
    volume_program_.use();
    set_lens(volume_program_, lens);
    volume_program_.set("camera_from_table", camera_from_object(plan.T_table_camera, table));
    glDepthFunc(GL_LESS);
    glStencilMask(kCountBits);
    glStencilFunc(GL_EQUAL, 0, kCasterBit);
    glStencilOpSeparate(GL_FRONT, GL_KEEP, GL_DECR_WRAP, GL_KEEP);
    glStencilOpSeparate(GL_BACK, GL_KEEP, GL_INCR_WRAP, GL_KEEP);
    volume.layout.bind();
    glDrawArrays(GL_TRIANGLES, 0, volume.count);
    // Any number but 0 -> dark, and 0 again.
    fill_program_.use();
    glDisable(GL_DEPTH_TEST);
    glStencilMask(kCountBits | kDarkBit);
    glStencilFunc(GL_NOTEQUAL, static_cast<GLint>(kDarkBit), kCountBits);
    glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
    no_vertices_.bind();
    glDrawArrays(GL_TRIANGLES, 0, 3);
    glStencilMask(kCasterBit);
    glClear(GL_STENCIL_BUFFER_BIT);
    calls += 2;
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDisable(GL_DEPTH_TEST);
  glEnable(GL_BLEND);
  glBlendFunc(GL_ZERO, GL_SRC_COLOR);
  glStencilMask(0);
  glStencilFunc(GL_EQUAL, static_cast<GLint>(kDarkBit), kDarkBit);
  glStencilOp(GL_KEEP, GL_KEEP, GL_KEEP);
  fill_program_.use();
  glm::vec3 left(1.0F);
  for (glm::length_t i = 0; i < 3; ++i) {
    const double share = plan.volumes.front().light_left[i];
    left[i] = static_cast<float>(1.0 - static_cast<double>(plan.overlay_opacity) *
                                           (1.0 - std::pow(share, 1.0 / 2.2)));
  }
  fill_program_.set("light_left", left);
  no_vertices_.bind();
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glStencilMask(0xFF);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  glDepthMask(GL_TRUE);
  return calls + 1;
}

}  // namespace penumbra
