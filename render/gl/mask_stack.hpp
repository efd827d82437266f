// Pictures of one size, drawn or uploaded one by one and read as an array texture: which of a
// shadow's layers lies where, at several heights.
#pragma once

#include <cstdint>
#include <span>

#include "render/gl/handle.hpp"

namespace penumbra {

class MaskStack {
 public:
  MaskStack();

  // RGBA of 8 bits. Storage is kept while this stays as it was; what is in it is not defined
  // afterwards.
  void resize(int width, int height, int count);
  // 4 bytes a texel, rows in order.
  void upload(int index, std::span<const std::uint8_t> rgba) const;
  // For drawing, with its viewport; all 0.
  void begin(int index);
  // Once it is drawn: what its texels hold is the mean over their samples, where the driver has
  // several of them.
  void end() const;
  // Sampled linearly, with the edge's values beyond it; row 0 of what was drawn is at 0.
  void bind(int unit) const;
  static void unbind(int unit);

 private:
  GlHandle<FramebufferTraits> framebuffer_;
  GlHandle<TextureTraits> texture_;
  GlHandle<FramebufferTraits> samples_framebuffer_;
  GlHandle<RenderbufferTraits> samples_;  // of one picture, drawn before it is resolved
  int sample_count_ = 0;                  // of a texel; 0: the picture is drawn itself
  int samples_width_ = 0;
  int samples_height_ = 0;
  int width_ = 0;
  int height_ = 0;
  int count_ = 0;
};

}  // namespace penumbra
