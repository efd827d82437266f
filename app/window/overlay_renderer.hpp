// Draws what Dear ImGui has laid out, in OpenGL 3.3 or OpenGL ES 3.0.
#pragma once

#include <vector>

#include "core/error.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/context.hpp"
#include "render/gl/handle.hpp"
#include "render/gl/shader.hpp"

struct ImDrawData;
struct ImFontAtlas;

namespace penumbra {

class OverlayRenderer {
 public:
  // Uploads the fonts. `context` is current on this thread, now and at every later call.
  [[nodiscard]] static Result<OverlayRenderer> create(const GlContext& context, ImFontAtlas& fonts);

  // Into the framebuffer that is bound, over all of it. What OpenGL is set to afterwards is what
  // the compositor leaves behind too: no blending, no scissor, no program that matters.
  void draw(const ImDrawData& data, GlContext::Size size);

 private:
  explicit OverlayRenderer(ShaderProgram program);

  ShaderProgram program_;
  TextureHandle fonts_;
  VertexArray layout_;
  GlBuffer vertices_{BufferUse::vertices};
  GlBuffer indices_{BufferUse::indices};
  bool layout_made_ = false;
};

}  // namespace penumbra
