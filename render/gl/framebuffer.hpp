// The picture's own framebuffer: RGBA8 with 24-bit depth and 8-bit stencil. Row 0 is the TOP row of
// the picture, so that reading back needs no turning over.
#pragma once

#include <cstdint>
#include <span>

#include "core/error.hpp"
#include "render/gl/context.hpp"
#include "render/gl/handle.hpp"

namespace penumbra {

class Framebuffer {
 public:
  [[nodiscard]] static Result<Framebuffer> create(int width, int height);

  void bind() const;  // for drawing, with its viewport
  // Rows top to bottom, width * height * 4 bytes.
  void read_rgba(std::span<std::uint8_t> rgba) const;
  // Depth and stencil are of no use after the frame; on a tiler this saves writing them out.
  void invalidate_depth_stencil() const;
  // Into the window's framebuffer, as large as fits with the picture's proportions.
  void present(GlContext::Size window) const;

 private:
  Framebuffer() = default;
  GlHandle<FramebufferTraits> framebuffer_;
  GlHandle<RenderbufferTraits> color_;
  GlHandle<RenderbufferTraits> depth_stencil_;
  int width_ = 0;
  int height_ = 0;
};

}  // namespace penumbra
