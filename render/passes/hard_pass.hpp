// Hard shadows of the scene's lights on planes. Each light has a stencil bit, set where any caster
// blocks it, so that overlapping casters darken a pixel once. Casters of different opacity have
// separate bits if there are enough bits. Each pixel then loses the fraction of light of its set of
// blocked lights, so that the shadows of several lights add up physically.
#pragma once

#include <Eigen/Geometry>
#include <map>
#include <memory>
#include <optional>
#include <tuple>

#include "render/gl/buffer.hpp"
#include "render/model/shadow_mesh.hpp"
#include "render/passes/casting_models.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/translucent_program.hpp"

namespace penumbra {

static_assert(kShadowBits == (1U << kMaxHardLights) - 1U, "each light has a stencil bit");

class HardPass : public Pass {
 public:
  [[nodiscard]] static Result<std::unique_ptr<HardPass>> create(GlApi api,
                                                                const CameraModel& camera);

  // Clips and projects casters again if a caster, plane or light moved.
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
  // The meaning of one stencil bit: casters of one light with equal opacity.
  struct BlockedLight {
    int light = 0;
    float strength = 1.0F;
    Eigen::AlignedBox2d bounds;
    std::vector<const Shadow*> shadows;
  };

  void make(const HardShadowDraw& draw, const ShadowMesh& mesh, Shadow& shadow, RenderWork& work);
  [[nodiscard]] std::vector<BlockedLight> blocked_lights(const FramePlan& plan,
                                                         const PlaneReceiver& receiver) const;
  int draw_plane(const DrawContext& context, const FramePlan& plan,
                 const PlaneReceiver& receiver) const;

  ShaderProgram shape_program_;
  TranslucentProgram light_program_;
  std::optional<double> longest_edge_;  // maximum edge [m]; nullopt: no lens distortion
  CastingModels<ShadowMesh> meshes_;
  std::map<Key, Shadow> shadows_;
};

}  // namespace penumbra
