// State shared by the passes of a frame, and their interface.
#pragma once

#include <optional>

#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/passes/object_painter.hpp"
#include "render/passes/receivers.hpp"
#include "render/passes/video_texture.hpp"
#include "render/render_work.hpp"
#include "render/scene/scene.hpp"
#include "render/translucency.hpp"

namespace penumbra {

struct DrawContext {
  const Scene& scene;
  const LensUniforms& lens;
  Framebuffer& framebuffer;  // bound while passes draw
  Receivers& receivers;      // begun for the plan before passes draw
  const ObjectPainter& objects;
  const VideoTexture& video;  // holds `frame` while passes draw
  const Frame& frame;
  // The format of the frames under shadows; none where the background is not the video pixel by
  // pixel.
  std::optional<PixelFormat> video_format;
  Translucency mode = Translucency::blend;  // never automatic
  RenderWork& work;
};

class Pass {
 public:
  Pass() = default;
  Pass(const Pass&) = delete;
  Pass& operator=(const Pass&) = delete;
  virtual ~Pass() = default;

  // Does the CPU's part for the plan and selects programs. May draw into framebuffers of its own.
  // Called for all passes, in the order in which they draw, before the frame is drawn.
  [[nodiscard]] virtual Result<void> prepare(const DrawContext& context, const FramePlan& plan) = 0;
  // Draws the plan that was prepared, over what earlier passes drew. Leaves depth test, stencil and
  // blending as it found them. Returns the number of draw calls since prepare().
  virtual int draw(const DrawContext& context, const FramePlan& plan) = 0;
};

}  // namespace penumbra
