// Draws the contact shades of objects on planes (docs/shadows.md#contact-shade).
#pragma once

#include <map>
#include <memory>
#include <utility>

#include "render/model/shadow_mesh.hpp"
#include "render/passes/casting_models.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/layers/field_quad.hpp"
#include "render/shadow/layers/own_frame.hpp"

namespace penumbra {

class ContactPass : public Pass {
 public:
  [[nodiscard]] static Result<std::unique_ptr<ContactPass>> create(GlApi api,
                                                                   const CameraModel& camera);

  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  int draw(const DrawContext& context, const FramePlan& plan) override;

 private:
  struct Caster {
    ShadowMesh mesh;
    double size = 0.0;  // largest distance of a vertex from the object's origin, unscaled [m]
  };
  // The shade of an object on a plane, which stays the same while the object slides or turns on it.
  struct Shade {
    OwnFrame own;
    double pose_s = 0.0, reach = 0.0;
    FieldTexture field{TextureFilter::linear};
    float greatest = 0.0F;  // (reach / cell)^2; 0: no shade
  };
  static Caster make_caster(const Model& model);
  void make(const ContactDraw& draw, const Caster& caster, const OwnFrame& own, Shade& shade) const;

  FieldQuad quad_;
  double finest_cell_ = 0.0;  // size of a pixel at kNearestDistance [m]
  CastingModels<Caster> casters_;
  std::map<std::pair<int, int>, Shade> shades_;  // by object and plane
};

}  // namespace penumbra
