// An array texture, drawn or uploaded image by image: masks of a shadow at several heights.
#pragma once

#include <cstdint>
#include <span>

#include "render/gl/handle.hpp"

namespace penumbra {

class MaskStack {
 public:
  MaskStack();

  // Allocates `count` RGBA8 images. Their contents are undefined afterwards.
  void resize(int width, int height, int count);
  // Replaces an image. `rgba`: 4 bytes per texel, row 0 first.
  void upload(int index, std::span<const std::uint8_t> rgba) const;
  // Binds and clears an image for drawing, with its viewport.
  void begin(int index);
  // Ends the drawing of an image; averages the samples of each texel.
  void end() const;
  // Binds the array with linear filtering, clamped to the edge; row 0 is at texture coordinate 0.
  void bind(int unit) const;
  static void unbind(int unit);

 private:
  FramebufferHandle framebuffer_;
  TextureHandle texture_;
  FramebufferHandle samples_framebuffer_;
  RenderbufferHandle samples_;  // samples of one image, before they are resolved
  int sample_count_ = 0;        // per texel; 0: no multisampling
  int samples_width_ = 0;
  int samples_height_ = 0;
  int width_ = 0;
  int height_ = 0;
  int count_ = 0;
};

}  // namespace penumbra
