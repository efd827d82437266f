// Layered, field and simple shadows on planes. Each pixel is darkened once with its darkest layer
// (umbra before middle before penumbra, over all casters of a plane together): from the plane's
// mask, or layer by layer. Drawn directly and blended, the stencil holds the first layer, so the
// umbra comes first; retextured, the last layer drawn is seen, so the penumbra comes first; a
// screen-door is the same in any order.
#pragma once

#include <map>
#include <memory>
#include <tuple>
#include <utility>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "render/passes/draw_context.hpp"
#include "render/passes/layer_painter.hpp"
#include "render/passes/mask_quad.hpp"
#include "render/passes/mesh_strips.hpp"
#include "render/passes/plane_masks.hpp"
#include "render/passes/shadow_geometry.hpp"
#include "render/shadow/kernels/twist.hpp"

namespace penumbra {

class ShadowPass : public Pass {
 public:
  // `geometry` and `painter` outlive the pass. `multisampled`: pixels of the framebuffer have
  // several samples.
  [[nodiscard]] static Result<std::unique_ptr<ShadowPass>> create(GlApi api,
                                                                  const CameraModel& camera,
                                                                  const ShadowGeometry& geometry,
                                                                  LayerPainter& painter,
                                                                  bool multisampled);

  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  int draw(const DrawContext& context, const FramePlan& plan) override;

  // The last plan's shadows that are made with kernels. Takes milliseconds for new kernels.
  [[nodiscard]] std::vector<CasterKernels> kernels_in_use();

 private:
  ShadowPass(const CameraModel& camera, const ShadowGeometry& geometry, LayerPainter& painter,
             bool multisampled, MaskQuad mask, MeshStrips strips)
      : geometry_(geometry),
        painter_(painter),
        masks_(camera, multisampled),
        mask_quad_(std::move(mask)),
        mesh_strips_(std::move(strips)) {}

  [[nodiscard]] Result<void> choose(const DrawContext& context, const FramePlan& plan);
  int draw_plane(const FramePlan& plan, int plane, const LayerPainter::Brush& brush) const;
  int draw_strips(const DrawContext& context, const FramePlan& plan, const PlaneReceiver& receiver,
                  const LayerPainter::Brush& brush) const;
  void bind_background(const DrawContext& context, const LayerPainter::Brush& brush) const;

  const ShadowGeometry& geometry_;
  LayerPainter& painter_;
  PlaneMasks masks_;
  MaskQuad mask_quad_;
  MeshStrips mesh_strips_;
  bool fetches_video_ = true;  // retextured, and not from a copy
  // One per shadow of the plan before: (node, object, plane, n-th of these in the plan).
  std::map<std::tuple<int, int, int, int>, PreparedShadow> prepared_;
  std::vector<ShadowItem> items_;  // one per shadow of the plan
};

}  // namespace penumbra
