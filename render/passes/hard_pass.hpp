// Hard shadows of the scene's lights on planes. Each light has a stencil bit, set where any caster
// blocks it, so that casters of one light darken a pixel once. Less opaque casters have separate
// bits, if there are enough. Then the pixels of each set of blocked lights lose the share of these
// lights: the shadows of several lights add up as light does.
#pragma once

#include <Eigen/Geometry>
#include <map>
#include <memory>
#include <optional>
#include <tuple>

#include "render/gl/buffer.hpp"
#include "render/model/shadow_mesh.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/translucent_program.hpp"

namespace penumbra {

static_assert(kShadowBits == (1U << kMaxHardLights) - 1U, "each light has a stencil bit");

class HardPass : public Pass {
 public:
  [[nodiscard]] static Result<std::unique_ptr<HardPass>> create(GlApi api,
                                                                const CameraModel& camera);

  // Clips and projects casters where a caster, plane or light moved.
  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  int draw(const DrawContext& context, const FramePlan& plan) override;

 private:
  // One caster's shadow from one light on one plane.
  struct Shadow {
    std::optional<HardShadowDraw> made_for;
    Eigen::AlignedBox2d bounds;  // on the plane [m]
    GlMesh triangles{2};
  };
  using Key = std::tuple<int, int, int>;  // object, plane, light
  // The meaning of one stencil bit: equally strong casters of one light.
  struct Blocked {
    int light = 0;
    float strength = 1.0F;
    Eigen::AlignedBox2d bounds;
    std::vector<const Shadow*> shadows;
  };

  const ShadowMesh& mesh_of(const Scene& scene, const HardShadowDraw& draw);
  void make(const HardShadowDraw& draw, const ShadowMesh& mesh, Shadow& shadow, RenderWork& work);
  [[nodiscard]] std::vector<Blocked> blocked_lights(const FramePlan& plan,
                                                    const PlaneReceiver& receiver) const;
  int draw_plane(const DrawContext& context, const FramePlan& plan,
                 const PlaneReceiver& receiver) const;

  ShaderProgram shape_program_;
  TranslucentProgram light_program_;
  std::optional<double> longest_edge_;  // [m]; none: the lens keeps straight edges straight
  std::map<const Model*, std::unique_ptr<ShadowMesh>> meshes_;
  std::map<Key, Shadow> shadows_;
};

}  // namespace penumbra
