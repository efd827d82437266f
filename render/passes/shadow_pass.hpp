// Layered, field and simple shadows on planes. Each pixel is darkened once, by the darkest layer
// over all casters of a plane, from the plane's mask or layer by layer. Order of layers: blend
// draws the umbra first, as marked pixels are not darkened again; retexture draws the penumbra
// first, as later layers overwrite earlier ones; a screen-door does not depend on the order.
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
  // `geometry` and `painter` must outlive the pass. `multisampled`: whether the framebuffer is.
  [[nodiscard]] static Result<std::unique_ptr<ShadowPass>> create(GlApi api,
                                                                  const CameraModel& camera,
                                                                  const ShadowGeometry& geometry,
                                                                  LayerPainter& painter,
                                                                  bool multisampled);

  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  int draw(const DrawContext& context, const FramePlan& plan) override;

  // Returns the kernels of the most recently prepared plan. Takes milliseconds for new kernels.
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
  bool fetches_video_ = true;  // retextured fragments fetch the video, not a framebuffer copy
  // Key: node, object, plane, and a number for each of the plan's shadows that have them in common.
  std::map<std::tuple<int, int, int, int>, PreparedShadow> prepared_;
  std::vector<ShadowItem> items_;  // one per shadow of the plan
};

}  // namespace penumbra
