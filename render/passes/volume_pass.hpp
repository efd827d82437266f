// Shadow volumes (Hudson's shadow of a 3D cursor) on all surfaces in the depth buffer: planes,
// phantoms and virtual objects. They also show projected shadows where these fall on phantoms.
// z-fail counting in the stencil, light by light, is correct for any eye position and near plane.
// Receivers are then drawn again where they are in shadow, and lose the light's fraction by
// Lambert's law. The fractions of several lights are summed before the image is darkened.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "render/gl/buffer.hpp"
#include "render/passes/casting_models.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/translucent_program.hpp"

namespace penumbra {

class VolumePass : public Pass {
 public:
  [[nodiscard]] static Result<std::unique_ptr<VolumePass>> create(GlApi api,
                                                                  const CameraModel& camera);

  // Makes the volumes of casters that moved or whose light moved.
  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  // Requires the depth of phantoms, objects and planes. A shadow has the lower opacity of its
  // caster and its receiver.
  int draw(const DrawContext& context, const FramePlan& plan) override;

 private:
  struct Volume {
    std::optional<ShadowVolumeDraw> made_for;
    bool light_inside = false;
    bool ends_above_floors = false;
    std::vector<int> batch_ends;  // in vertices
    GlMesh surface{3};
  };
  using Casters = std::vector<const ShadowVolumeDraw*>;  // casters of one light

  // Which pixels to darken, and their stencil value afterwards.
  struct Darkening {
    unsigned tested = 0;   // darkens pixels with any of these bits set
    unsigned after = 0;    // stencil value of darkened pixels
    unsigned written = 0;  // bits in which `after` is written
    float strength = 1.0F;
    bool add_up = false;
  };
  struct Drawing {
    const FramePlan& plan;
    const LensUniforms& lens;
    const ObjectPainter& objects;
    const Receivers& receivers;
  };

  static void report_problems(const ShadowVolumeDraw& draw, const Volume& volume, RenderWork& work);
  int mark_caster(const Drawing& drawing, const ShadowVolumeDraw& draw) const;
  static void clear_mark();
  // Counts how often each pixel's ray enters one batch of the volume (z-fail): faces behind the
  // pixel's surface count up if they face away from the eye, else down. Skips marked pixels.
  void count(const Drawing& drawing, const ShadowVolumeDraw& draw, std::size_t batch) const;
  // Marks the pixels inside any batch of the volume as dark.
  int mark_volume(const Drawing& drawing, const ShadowVolumeDraw& draw) const;
  void mark_dark() const;
  int darken(const Drawing& drawing, const ShadowVolumeDraw& draw, const Darkening& how) const;
  int darken_planes(const Drawing& drawing, int light, const Darkening& how) const;
  void darken_by_sums(const FramePlan& plan, Framebuffer& framebuffer) const;
  int draw_light(const Drawing& drawing, Casters casters, bool add_up) const;

  ShaderProgram volume_program_;
  ShaderProgram fill_program_;
  TranslucentProgram plane_program_;
  TranslucentProgram light_sum_program_;
  Translucency mode_ = Translucency::blend;
  std::optional<double> longest_edge_;  // maximum edge [m]; nullopt: no lens distortion
  VertexArray no_vertices_;
  CastingModels<VolumeCaster> casters_;
  std::map<std::pair<int, int>, Volume> volumes_;  // by object and light
};

}  // namespace penumbra
