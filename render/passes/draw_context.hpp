// State shared by the passes of a frame, and their interface.
#pragma once

#include <optional>

#include "render/frame_plan.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/passes/object_painter.hpp"
#include "render/passes/receivers.hpp"
#include "render/passes/video_texture.hpp"

namespace penumbra {

struct DrawContext {
  const Scene& scene;
  const LensUniforms& lens;
  Framebuffer& framebuffer;  // bound while passes draw
  Receivers& receivers;      // begin_frame() is called before passes draw
  const ObjectPainter& objects;
  const VideoTexture& video;  // holds `frame` while passes draw, if a shader converts it
  const Frame& frame;
  // The format of the frame under the shadows; nullopt if the background is not the video 1:1.
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

  // Prepares the plan on the CPU and selects programs. May draw into its own framebuffers. Called
  // for all passes, in drawing order, before any of them draws.
  [[nodiscard]] virtual Result<void> prepare(const DrawContext& /*context*/,
                                             const FramePlan& /*plan*/) {
    return {};
  }
  // Draws the prepared plan over the earlier passes. Returns the number of draw calls, including
  // those of prepare(). State before and after: all write masks on, depth function GL_LESS; stencil
  // test, blending and face culling off. The depth test and the stencil contents are undefined.
  virtual int draw(const DrawContext& context, const FramePlan& plan) = 0;
};

}  // namespace penumbra
