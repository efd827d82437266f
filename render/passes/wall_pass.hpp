// Draws the virtual walls of the technique `walls` as faint panes with a grid, so that the shadows
// on them have a visible surface (docs/rendering.md#virtual-walls).
#pragma once

#include <memory>

#include "render/passes/draw_context.hpp"
#include "render/passes/translucent_program.hpp"

namespace penumbra {

class WallPass : public Pass {
 public:
  [[nodiscard]] static Result<std::unique_ptr<WallPass>> create(GlApi api,
                                                                const CameraModel& camera);

  [[nodiscard]] Result<void> prepare(const DrawContext& context, const FramePlan& plan) override;
  int draw(const DrawContext& context, const FramePlan& plan) override;

 private:
  void draw_wall(const DrawContext& context, const FramePlan& plan,
                 const PlaneReceiver& wall) const;

  TranslucentProgram program_;
  float line_width_ = 1.0F;  // of the grid [px]
};

}  // namespace penumbra
