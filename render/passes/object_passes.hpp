// Phantoms, virtual objects and see-through surfaces, each drawn in its turn.
#pragma once

#include "render/passes/draw_context.hpp"

namespace penumbra {

// Phantoms are real things: they write depth only.
class PhantomPass : public Pass {
 public:
  [[nodiscard]] Result<void> prepare(const DrawContext&, const FramePlan&) override { return {}; }
  int draw(const DrawContext& context, const FramePlan& plan) override {
    return context.objects.draw_phantoms(context.scene, plan, context.lens);
  }
};

class ObjectPass : public Pass {
 public:
  [[nodiscard]] Result<void> prepare(const DrawContext&, const FramePlan&) override { return {}; }
  int draw(const DrawContext& context, const FramePlan& plan) override {
    return context.objects.draw_objects(context.scene, plan, context.lens, context.framebuffer);
  }
};

// After the shadows: surfaces that blend receive none.
class BlendedPass : public Pass {
 public:
  [[nodiscard]] Result<void> prepare(const DrawContext&, const FramePlan&) override { return {}; }
  int draw(const DrawContext& context, const FramePlan& plan) override {
    return context.objects.draw_blended(plan, context.lens, context.framebuffer);
  }
};

}  // namespace penumbra
