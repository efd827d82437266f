// Framebuffers: RGBA8 with 24-bit depth and 8-bit stencil, with one or several samples per pixel.
// Row 0 is the TOP row of the image, so that reading back needs no flip.
#pragma once

#include <cstdint>
#include <span>

#include "core/error.hpp"
#include "core/image/image_view.hpp"
#include "core/image/pixel_rect.hpp"
#include "render/gl/context.hpp"
#include "render/gl/handle.hpp"

namespace penumbra {

// The area of a window that an image fills, letterboxed [px], from the window's top left corner.
struct ImageArea {
  int x = 0, y = 0, width = 0, height = 0;
};
[[nodiscard]] ImageArea image_area(int image_width, int image_height, GlContext::Size window);

// Shows images from main memory in a window.
class UploadedImage {
 public:
  [[nodiscard]] static Result<UploadedImage> create(int width, int height);
  // Copies to the window's framebuffer, at image_area(). `rgba`: rows top to bottom, width *
  // height * 4 bytes.
  void present(std::span<const std::uint8_t> rgba, GlContext::Size window);

 private:
  UploadedImage() = default;
  FramebufferHandle framebuffer_;
  TextureHandle texture_;
  int width_ = 0;
  int height_ = 0;
};

// Returns whether the current context can read depth and stencil back.
[[nodiscard]] bool can_read_depth();

class Framebuffer {
 public:
  Framebuffer() = default;  // no framebuffer
  // `samples`: per pixel; 0: no multisampling. Fails if the driver supports fewer.
  [[nodiscard]] static Result<Framebuffer> create(int width, int height, int samples = 0);
  // Samples per pixel, at least the requested number; 0 without multisampling.
  [[nodiscard]] int samples() const { return samples_; }
  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }

  void bind() const;  // binds for drawing and sets the viewport
  // Binds and clears a second colour buffer ("sums") with the same depth and stencil, in which
  // passes add up terms: half-float RGBA, or 8 bits if the driver can't render to half floats.
  void bind_sums();
  // Binds the sums as a texture, and this framebuffer for drawing.
  void bind_sums_texture(int unit);
  // Copies the image, or the sums, and binds the copy as a texture. Leaves the copied framebuffer
  // bound for drawing.
  void copy_image(int unit);
  void copy_sums(int unit);
  // Like copy_image(), at a quarter of the size, smoothed, with mipmaps.
  void copy_image_reduced(int unit);
  // Reads rows top to bottom, width * height * 4 bytes; multisampled pixels are averaged.
  void read_rgba(std::span<std::uint8_t> rgba) const;
  // Reads a part of the image, and its depth and stencil, rows top to bottom. Depth is in the upper
  // 24 bits. Only without multisampling, and with can_read_depth().
  void read_part(const PixelRect& part, std::span<std::uint8_t> rgba,
                 std::span<std::uint32_t> depth_stencil) const;
  // Replaces a part of the image. Only without multisampling.
  void write_part(const PixelRect& part, std::span<const std::uint8_t> rgba);
  // Reads into the bound pixel pack buffer, asynchronously.
  void read_rgba_to_buffer() const;
  // Discards depth and stencil at the end of a frame, so that tiling GPUs don't store them.
  void invalidate_depth_stencil() const;
  // Copies to the window's framebuffer, at image_area().
  void present(GlContext::Size window) const;
  void clear() const;  // to opaque black

 private:
  struct Copy {
    FramebufferHandle framebuffer;  // made on demand
    TextureHandle texture;
  };
  void make_sums();
  // Leaves the texture bound to the active unit.
  static Copy make_copy(ImageSize size, bool half_floats);
  // Returns a single-sample framebuffer with the image: framebuffer_, or a copy.
  [[nodiscard]] unsigned resolved() const;
  void read(void* rgba) const;
  void copy(unsigned from, Copy& to, bool half_floats, int unit) const;

  FramebufferHandle framebuffer_;
  RenderbufferHandle color_samples_;  // used with multisampling
  TextureHandle color_;               // used without multisampling
  RenderbufferHandle depth_stencil_;
  FramebufferHandle sums_framebuffer_;  // made on demand
  TextureHandle sums_;                  // used without multisampling
  RenderbufferHandle sums_samples_;     // used with multisampling
  bool sums_are_half_floats_ = true;
  Copy image_copy_, sums_copy_, reduced_copy_;
  mutable Copy resolved_;
  int width_ = 0;
  int height_ = 0;
  int samples_ = 0;
};

}  // namespace penumbra
