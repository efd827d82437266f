// Shadow volumes (Hudson's shadow of a 3D cursor) on everything that is in the depth buffer:
// planes, phantoms and virtual objects; and the part of projected shadows that falls on phantoms.
// z-fail counting is right wherever the eye is and whatever the near plane cuts. The stencil counts
// light by light; receivers are then drawn again where they are dark and lose the light's share by
// Lambert's law (a face turned away from the light loses nothing). Where a pixel is dark for
// several lights, their shares are summed before the image is darkened, so each is taken away once.
#pragma once

#include <glm/vec3.hpp>
#include <map>
#include <memory>
#include <optional>
#include <tuple>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/gl/shader.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/object_painter.hpp"
#include "render/passes/receivers.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/passes/volume_buffers.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/volumes/shadow_volume.hpp"

namespace penumbra {

class VolumePass : public Pass {
 public:
  [[nodiscard]] static Result<std::unique_ptr<VolumePass>> create(GlApi api,
                                                                  const CameraModel& camera);

  // Makes the volumes of casters that moved, or whose light did.
  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  // Needs the depth of phantoms, objects and planes. The shadow is as strong as the fainter of its
  // caster and its receiver.
  int draw(const DrawContext& context, const FramePlan& plan) override;

 private:
  struct Volume {
    bool valid = false;
    Placement T_table_object;
    Eigen::Vector4d light;
    std::vector<PlaneFrame> floors;
    std::vector<Ball> receivers;
    bool light_inside = false;
    bool ends_above_floors = false;
    VolumeBuffers buffers;
  };
  using Key = std::tuple<int, int>;  // object, light

  // The casters of one light.
  using Casters = std::vector<const ShadowVolumeDraw*>;

  VolumePass(ShaderProgram volume, ShaderProgram fill, TranslucentProgram plane,
             TranslucentProgram light_sum)
      : volume_program_(std::move(volume)),
        fill_program_(std::move(fill)),
        plane_program_(std::move(plane)),
        light_sum_program_(std::move(light_sum)) {}

  // Which pixels are dark, and the stencil that they get when they have been darkened.
  struct Darkening {
    unsigned tested = 0;   // any of these bits is set
    unsigned after = 0;    // written to ...
    unsigned written = 0;  // ... these bits
    float strength = 1.0F;
    bool add_up = false;
  };
  struct Drawing {
    const Scene& scene;
    const FramePlan& plan;
    const LensUniforms& lens;
    const ObjectPainter& objects;
    const Receivers& receivers;
  };

  static void note_trouble(const ShadowVolumeDraw& draw, const Volume& volume, RenderWork& work);
  int mark_caster(const Drawing& drawing, const ShadowVolumeDraw& draw) const;
  static void clear_mark();
  // Counts in the stencil how often each pixel's ray is in one batch of the volume.
  void count(const Drawing& drawing, const ShadowVolumeDraw& draw, std::size_t batch) const;
  // Marks as dark the pixels that any batch of the volume holds.
  int note_volume(const Drawing& drawing, const ShadowVolumeDraw& draw) const;
  void note_dark() const;
  int darken(const Drawing& drawing, const ShadowVolumeDraw& draw, const Darkening& how) const;
  void begin(const Darkening& how) const;
  int darken_planes(const Drawing& drawing, int light, const Darkening& how) const;
  void darken_by_sums(const FramePlan& plan, Framebuffer& framebuffer) const;
  int draw_light(const Drawing& drawing, Casters casters, bool add_up) const;

  ShaderProgram volume_program_;
  ShaderProgram fill_program_;
  TranslucentProgram plane_program_;
  TranslucentProgram light_sum_program_;
  Translucency mode_ = Translucency::blend;
  std::optional<double> longest_edge_;  // [m]; none: the lens keeps straight edges straight
  VertexArray no_vertices_;
  std::map<const Model*, std::unique_ptr<VolumeCaster>> casters_;
  std::map<Key, Volume> volumes_;
};

}  // namespace penumbra
