// Draws Dear ImGui's draw lists, in OpenGL 3.3 or OpenGL ES 3.0.
#pragma once

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
  // Uploads the fonts. `context` must be current on this thread at this and every later call.
  [[nodiscard]] static Result<OverlayRenderer> create(const GlContext& context, ImFontAtlas& fonts);

  // Draws over the bound framebuffer. Afterwards blending and scissor test are off, as after the
  // compositor; the bound program is undefined.
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
