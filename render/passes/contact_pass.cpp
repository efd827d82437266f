#include "render/passes/contact_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>

#include "core/propagate.hpp"
#include "render/model/to_eigen.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/fields/contact_shade.hpp"

namespace penumbra {
namespace {

constexpr int kOwnFrameBits = 13;  // as for fields
// The shade is smooth, so that it needs fewer cells than a shadow's outline.
constexpr int kCells = 96;

}  // namespace

Result<std::unique_ptr<ContactPass>> ContactPass::create(GlApi api, const CameraModel& camera) {
  auto pass = std::make_unique<ContactPass>();
  PENUMBRA_TRY(pass->quad_, FieldQuad::create(api, longest_edge(camera), {"contact.frag.glsl"}));
  const CameraParameters& p = camera.parameters();
  pass->finest_cell_ = kNearestDistance / std::max(p.fx, p.fy);
  return pass;
}

ContactPass::Caster ContactPass::make_caster(const Model& model) {
  Caster caster{make_shadow_mesh(model, {}, CutOuts::visible_regions)};
  for (const glm::vec3& p : caster.mesh.positions)
    caster.size = std::max(caster.size, to_eigen(p).norm());
  return caster;
}

void ContactPass::make(const ContactDraw& draw, const Caster& caster, const OwnFrame& own,
                       Shade& shade) const {
  const ShadowKernels none{Eigen::Vector3d::UnitZ(), caster.mesh.positions, {}};
  ShadowFieldOptions options;
  options.cells = kCells;
  options.finest_cell = finest_cell_;
  const ShadowField field =
      contact_shade(place_caster(caster.mesh, none, own.T_own_object, PlaneFrame()),
                    caster.mesh.indices, draw.reach, options);
  shade.greatest =
      field.cell > 0.0 ? static_cast<float>(std::pow(draw.reach / field.cell, 2.0)) : 0.0F;
  if (shade.greatest > 0.0F) shade.field.upload(field);
}

Result<void> ContactPass::prepare(const DrawContext& context, const FramePlan& plan) {
  if (!plan.reuse) shades_.clear();
  if (plan.contacts.empty()) return {};
  for (const ContactDraw& draw : plan.contacts) {
    const Caster& caster = casters_.of(context.scene, draw.object, false, make_caster);
    Shade& shade = shades_[{draw.object, draw.plane}];
    const OwnFrame own = OwnFrame::make(draw.T_table_object, draw.plane_frame,
                                        draw.T_table_object.scale * caster.size, kOwnFrameBits);
    const bool reused =
        shade.reach == draw.reach && shade.pose_s == draw.pose_s && shade.own.same_shape(own);
    shade.own = own;
    if (reused) continue;
    shade.pose_s = draw.pose_s;
    shade.reach = draw.reach;
    make(draw, caster, own, shade);
  }
  return quad_.choose(context.mode, std::nullopt);
}

int ContactPass::draw(const DrawContext& context, const FramePlan& plan) {
  if (plan.contacts.empty()) return 0;
  const ShaderProgram& program = quad_.program().get();
  int calls = 0;
  for (const PlaneReceiver& receiver : plan.receivers) {
    if (std::ranges::find(plan.contacts, receiver.plane, &ContactDraw::plane) ==
        plan.contacts.end())
      continue;
    context.receivers.begin_plane(plan, receiver.plane, receiver.frame, context.lens);
    context.receivers.test_plane();
    glStencilMask(0);
    begin_translucent(context.mode, Blending::darken);
    quad_.begin(program, context.lens, camera_from_plane(plan.T_table_camera, receiver.frame));
    program.set("encoding", static_cast<float>(1.0 / plan.tone_exponent));
    program.set("contact_light", static_cast<float>(kContactLight));
    for (const ContactDraw& draw : plan.contacts) {
      const Shade& shade = shades_.at({draw.object, draw.plane});
      if (draw.plane != receiver.plane || shade.greatest <= 0.0F) continue;
      // The shades of several objects are multiplied, so that there is no seam between them.
      if (context.mode == Translucency::retexture)
        context.framebuffer.copy_image(kFramebufferCopyUnit);
      program.set("opacity", draw.opacity);
      program.set("greatest", shade.greatest);
      quad_.draw(program, shade.field, shade.own.T_plane_own);
      ++calls;
    }
  }
  end_planes();
  return calls;
}

}  // namespace penumbra
