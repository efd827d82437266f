#include "app/window/overlay_renderer.hpp"

#include <epoxy/gl.h>
#include <imgui.h>

#include <algorithm>
#include <cstddef>
#include <span>
#include <utility>

#include "core/propagate.hpp"

namespace penumbra {

static_assert(sizeof(ImDrawIdx) == 2);

OverlayRenderer::OverlayRenderer(ShaderProgram program)
    : program_(std::move(program)), fonts_(TextureHandle::create()) {}

Result<OverlayRenderer> OverlayRenderer::create(const GlContext& context, ImFontAtlas& fonts) {
  PENUMBRA_TRY(auto program, ShaderProgram::link(context.info().api, {"overlay.vert.glsl"},
                                                 {"overlay.frag.glsl"}));
  OverlayRenderer renderer(std::move(program));
  unsigned char* texels = nullptr;
  int width = 0, height = 0;
  fonts.GetTexDataAsRGBA32(&texels, &width, &height);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, renderer.fonts_.id());
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  glPixelStorei(GL_UNPACK_ALIGNMENT, 4);
  glPixelStorei(GL_UNPACK_ROW_LENGTH, 0);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA8, width, height, 0, GL_RGBA, GL_UNSIGNED_BYTE, texels);
  fonts.ClearTexData();
  return renderer;
}

void OverlayRenderer::draw(const ImDrawData& data, GlContext::Size size) {
  if (data.CmdListsCount == 0 || size.width <= 0 || size.height <= 0) return;
  glViewport(0, 0, size.width, size.height);
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_CULL_FACE);
  glEnable(GL_BLEND);
  glBlendFunc(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA);
  glEnable(GL_SCISSOR_TEST);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  program_.use();
  program_.set("screen_size",
               glm::vec2(static_cast<float>(size.width), static_cast<float>(size.height)));
  program_.set("glyphs", 0);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, fonts_.id());
  layout_.bind();
  for (int i = 0; i < data.CmdListsCount; ++i) {
    const ImDrawList& list = *data.CmdLists[i];
    vertices_.write(std::span<const ImDrawVert>(list.VtxBuffer.Data,
                                                static_cast<std::size_t>(list.VtxBuffer.Size)),
                    BufferLife::every_frame);
    indices_.write(std::span<const ImDrawIdx>(list.IdxBuffer.Data,
                                              static_cast<std::size_t>(list.IdxBuffer.Size)),
                   BufferLife::every_frame);
    if (!layout_made_) {
      VertexArray::attribute(0, 2, sizeof(ImDrawVert), offsetof(ImDrawVert, pos));
      VertexArray::attribute(1, 2, sizeof(ImDrawVert), offsetof(ImDrawVert, uv));
      glEnableVertexAttribArray(2);
      glVertexAttribPointer(2, 4, GL_UNSIGNED_BYTE, GL_TRUE, sizeof(ImDrawVert),
                            reinterpret_cast<const void*>(offsetof(ImDrawVert, col)));
      layout_made_ = true;
    }
    for (const ImDrawCmd& command : list.CmdBuffer) {
      if (command.UserCallback != nullptr) continue;
      const int left = std::max(0, static_cast<int>(command.ClipRect.x));
      const int top = std::max(0, static_cast<int>(command.ClipRect.y));
      const int right = std::min(size.width, static_cast<int>(command.ClipRect.z));
      const int bottom = std::min(size.height, static_cast<int>(command.ClipRect.w));
      if (right <= left || bottom <= top) continue;
      glScissor(left, size.height - bottom, right - left, bottom - top);
      glDrawElements(GL_TRIANGLES, static_cast<GLsizei>(command.ElemCount), GL_UNSIGNED_SHORT,
                     reinterpret_cast<const void*>(static_cast<std::size_t>(command.IdxOffset) *
                                                   sizeof(ImDrawIdx)));
    }
  }
  glDisable(GL_SCISSOR_TEST);
  glDisable(GL_BLEND);
}

}  // namespace penumbra
