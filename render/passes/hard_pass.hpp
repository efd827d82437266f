// Hard shadows of the scene's lights on planes. Each light has a stencil bit, set where any caster
// blocks it, so casters of one light darken a pixel once. Faint casters have separate bits, as far
// as there are bits. Then the pixels of each set of blocked lights are darkened by the share of the
// light that these lights give there: the shadows of several lights add up as light does.
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
#include "render/model/shadow_mesh.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/receivers.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

static_assert(kShadowBits == (1U << kMaxHardLights) - 1U, "each light has a stencil bit");

class HardPass : public Pass {
 public:
  [[nodiscard]] static Result<std::unique_ptr<HardPass>> create(GlApi api, const Scene& scene,
                                                                const CameraModel& camera);

  // Clips and projects casters where a caster, plane or light moved.
  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  int draw(const DrawContext& context, const FramePlan& plan) override;

 private:
  // One caster's shadow from one light on one plane, on the GPU.
  struct Shadow {
    bool valid = false;
    PlaneFrame plane;
    Placement T_table_object;
    Eigen::Vector4d light;
    Eigen::Vector2d low, high;  // bounds on the plane [m]
    int count = 0;              // vertices; 0: no shadow
    bool layout_made = false;
    VertexArray layout;
    GlBuffer vertices{BufferUse::vertices};
  };
  using Key = std::tuple<int, int, int>;  // object, plane, light

  HardPass(ShaderProgram shape, TranslucentProgram light)
      : shape_program_(std::move(shape)), light_program_(std::move(light)) {}

  const ShadowMesh& mesh_of(const Scene& scene, const HardShadowDraw& draw);
  void make(const HardShadowDraw& draw, const ShadowMesh& mesh, Shadow& shadow, RenderWork& work);
  int draw_plane(const DrawContext& context, const FramePlan& plan,
                 const PlaneReceiver& receiver) const;

  ShaderProgram shape_program_;
  TranslucentProgram light_program_;
  std::optional<double> longest_edge_;  // [m]; none: the lens keeps straight edges straight
  std::map<const Model*, std::unique_ptr<ShadowMesh>> meshes_;
  std::map<Key, Shadow> shadows_;
};

}  // namespace penumbra
