// The picture's own framebuffer: RGBA8 with 24-bit depth and 8-bit stencil, of one or several
// samples a pixel. Row 0 is the TOP row of the picture, so that reading back needs no turning over.
#pragma once

#include <cstdint>
#include <span>

#include "core/error.hpp"
#include "render/gl/context.hpp"
#include "render/gl/handle.hpp"

namespace penumbra {

// The part of a window that a picture fills, as large as fits with its proportions [px], from the
// window's top left corner.
struct PictureArea {
  int x = 0, y = 0, width = 0, height = 0;
};
[[nodiscard]] PictureArea picture_area(int picture_width, int picture_height,
                                       GlContext::Size window);

// A picture that was put together elsewhere, for a window.
class UploadedPicture {
 public:
  [[nodiscard]] static Result<UploadedPicture> create(int width, int height);
  // `rgba`: rows top to bottom, width * height * 4 bytes. Into the window's framebuffer, at
  // picture_area().
  void present(std::span<const std::uint8_t> rgba, GlContext::Size window);

 private:
  UploadedPicture() = default;
  GlHandle<FramebufferTraits> framebuffer_;
  GlHandle<TextureTraits> texture_;
  int width_ = 0;
  int height_ = 0;
};

class Framebuffer {
 public:
  // `samples`: of each pixel; 0: one, in the pixel's middle, without multisampling. Fails where the
  // driver has no so many.
  [[nodiscard]] static Result<Framebuffer> create(int width, int height, int samples = 0);
  // As many as the driver has of each pixel, or 0 without multisampling; at least as many as asked.
  [[nodiscard]] int samples() const { return samples_; }

  void bind() const;  // for drawing, with its viewport
  // For drawing into a second picture over the same depth and stencil, in which passes add up what
  // they then take from bind()'s at once: RGBA, half floats where the driver draws those, else 8
  // bits. All 0 after bind_sums(). Made by the first bind_sums().
  void bind_sums();
  // Leaves bind() bound for drawing.
  void bind_sums_texture(int unit);
  // A texture with the picture, or with the sums, as they are now, for programs that draw into them
  // and cannot read them. Leaves bound for drawing what it copied.
  void copy_picture(int unit);
  void copy_sums(int unit);
  // Rows top to bottom, width * height * 4 bytes; of several samples their mean.
  void read_rgba(std::span<std::uint8_t> rgba) const;
  // The same into the pixel pack buffer that is bound, from its first byte on, behind what was
  // drawn: nothing waits for it.
  void read_rgba_to_buffer() const;
  // Depth and stencil are of no use after the frame; on a tiler this saves writing them out.
  void invalidate_depth_stencil() const;
  // Into the window's framebuffer, at picture_area().
  void present(GlContext::Size window) const;
  // Opaque black.
  void clear() const;

 private:
  struct Copy {
    GlHandle<FramebufferTraits> framebuffer;  // none until it is asked for
    GlHandle<TextureTraits> texture;
  };
  Framebuffer() = default;
  // What is read, presented: the framebuffer itself, or the mean of its samples as they are now.
  [[nodiscard]] unsigned resolved() const;
  void read(void* rgba) const;
  void copy(unsigned from, Copy& to, bool half_floats, int unit) const;
  GlHandle<FramebufferTraits> framebuffer_;
  GlHandle<RenderbufferTraits> color_;
  GlHandle<RenderbufferTraits> depth_stencil_;
  GlHandle<FramebufferTraits> sums_framebuffer_;  // none until it is asked for
  GlHandle<TextureTraits> sums_;                  // of one sample
  GlHandle<RenderbufferTraits> sums_samples_;     // of several
  bool sums_are_half_floats_ = true;
  Copy picture_copy_, sums_copy_;
  mutable Copy resolved_;
  int width_ = 0;
  int height_ = 0;
  int samples_ = 0;
};

}  // namespace penumbra
