// Layered, field and simple shadows on planes. Each pixel is darkened once by its darkest layer
// over all casters of a plane (umbra before middle before penumbra): from the plane's mask, or
// layer by layer. Blended layers mark the stencil, so the umbra comes first; of retextured ones the
// last is seen, so the penumbra comes first; a screen-door is the same in any order.
#pragma once

#include <map>
#include <memory>
#include <tuple>
#include <vector>

#include "render/passes/draw_context.hpp"
#include "render/passes/layers/layer_painter.hpp"
#include "render/passes/layers/mask_quad.hpp"
#include "render/passes/layers/mesh_strips.hpp"
#include "render/passes/layers/plane_masks.hpp"
#include "render/passes/layers/shadow_geometry.hpp"
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

  // Returns the last plan's shadows with kernels. Takes milliseconds for new kernels.
  [[nodiscard]] std::vector<CasterKernels> kernels_in_use();

 private:
  ShadowPass(const CameraModel& camera, const ShadowGeometry& geometry, LayerPainter& painter,
             bool multisampled)
      : geometry_(geometry), painter_(painter), masks_(camera, multisampled) {}

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
  bool fetches_video_ = true;  // retextured fragments fetch the video, not a copy
  // By (node, object, plane, n-th of these in the plan).
  std::map<std::tuple<int, int, int, int>, PreparedShadow> prepared_;
  std::vector<ShadowItem> items_;  // one per shadow of the plan
};

}  // namespace penumbra
