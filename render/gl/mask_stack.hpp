// Images of one size that are drawn or uploaded one by one and read as an array texture: masks of a
// shadow's layers at several heights.
#pragma once

#include <cstdint>
#include <span>

#include "render/gl/handle.hpp"

namespace penumbra {

class MaskStack {
 public:
  MaskStack();

  // RGBA8. The contents are undefined afterwards.
  void resize(int width, int height, int count);
  // 4 bytes a texel, rows in order.
  void upload(int index, std::span<const std::uint8_t> rgba) const;
  // Binds and clears an image for drawing, with its viewport.
  void begin(int index);
  // Ends the drawing: a texel becomes the mean of its samples.
  void end() const;
  // Filtered linearly, clamped to the edge; row 0 of what was drawn is at texture coordinate 0.
  void bind(int unit) const;
  static void unbind(int unit);

 private:
  FramebufferHandle framebuffer_;
  TextureHandle texture_;
  FramebufferHandle samples_framebuffer_;
  RenderbufferHandle samples_;  // of one image, before it is resolved
  int sample_count_ = 0;        // per texel; 0: no multisampling
  int samples_width_ = 0;
  int samples_height_ = 0;
  int width_ = 0;
  int height_ = 0;
  int count_ = 0;
};

}  // namespace penumbra
