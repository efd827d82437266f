#include "render/gl/framebuffer.hpp"

#include <epoxy/gl.h>

#include <algorithm>

#include "core/assert.hpp"

namespace penumbra {
namespace {

tl::unexpected<Error> too_large(int width, int height, int largest) {
  return fail(
      "an image of {} x {} px is too large for this graphics driver (at most {} px); use a "
      "smaller size",
      width, height, largest);
}

void clear_color(float alpha) {
  glDisable(GL_SCISSOR_TEST);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glClearColor(0.0F, 0.0F, 0.0F, alpha);
  glClear(GL_COLOR_BUFFER_BIT);
}

// Creates a texture with nearest filtering and binds it to the active unit.
TextureHandle nearest_texture() {
  TextureHandle texture = TextureHandle::create();
  glBindTexture(GL_TEXTURE_2D, texture.id());
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  return texture;
}

// Allocates RGBA storage for the bound texture.
void store_rgba(bool half_floats, int width, int height) {
  glTexImage2D(GL_TEXTURE_2D, 0, half_floats ? GL_RGBA16F : GL_RGBA8, width, height, 0, GL_RGBA,
               half_floats ? GL_HALF_FLOAT : GL_UNSIGNED_BYTE, nullptr);
}

// Copies the colours of a framebuffer into another, which stays bound for drawing.
void blit(GLuint from, ImageSize size, GLuint to, ImageSize to_size, GLenum filter) {
  glBindFramebuffer(GL_READ_FRAMEBUFFER, from);
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, to);
  glDisable(GL_SCISSOR_TEST);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glBlitFramebuffer(0, 0, size.width, size.height, 0, 0, to_size.width, to_size.height,
                    GL_COLOR_BUFFER_BIT, filter);
}

// Copies into the window's framebuffer, letterboxed.
void show(GLuint framebuffer, int width, int height, GlContext::Size window) {
  if (window.width <= 0 || window.height <= 0) return;
  const ImageArea area = image_area(width, height, window);
  const int bottom = window.height - area.y - area.height;
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, 0);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer);
  glDisable(GL_SCISSOR_TEST);
  if (area.width != window.width || area.height != window.height) clear_color(1.0F);
  // Flipped: a window's row 0 is its bottom row.
  glBlitFramebuffer(0, 0, width, height, area.x, bottom + area.height, area.x + area.width, bottom,
                    GL_COLOR_BUFFER_BIT,
                    area.width == width && area.height == height ? GL_NEAREST : GL_LINEAR);
}

}  // namespace

ImageArea image_area(int image_width, int image_height, GlContext::Size window) {
  const double scale = std::min(static_cast<double>(window.width) / image_width,
                                static_cast<double>(window.height) / image_height);
  ImageArea area;
  area.width = std::max(1, static_cast<int>(scale * image_width + 0.5));
  area.height = std::max(1, static_cast<int>(scale * image_height + 0.5));
  area.x = (window.width - area.width) / 2;
  area.y = (window.height - area.height) / 2;
  return area;
}

bool can_read_depth() {
  return epoxy_is_desktop_gl() || epoxy_has_gl_extension("GL_NV_read_depth_stencil");
}

Result<Framebuffer> Framebuffer::create(int width, int height, int samples) {
  GLint largest = 0;
  glGetIntegerv(GL_MAX_RENDERBUFFER_SIZE, &largest);
  GLint largest_texture = 0;
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &largest_texture);
  largest = std::min(largest, largest_texture);
  if (width > largest || height > largest) {
    return too_large(width, height, largest);
  }
  GLint max_samples = 0;
  glGetIntegerv(GL_MAX_SAMPLES, &max_samples);
  if (samples > max_samples) {
    return fail("{} samples a pixel: this graphics driver has at most {}; ask for fewer (--msaa)",
                samples, max_samples);
  }
  Framebuffer f;
  f.width_ = width;
  f.height_ = height;
  f.framebuffer_ = FramebufferHandle::create();
  f.depth_stencil_ = RenderbufferHandle::create();
  glBindFramebuffer(GL_FRAMEBUFFER, f.framebuffer_.id());
  if (samples > 0) {
    f.color_samples_ = RenderbufferHandle::create();
    glBindRenderbuffer(GL_RENDERBUFFER, f.color_samples_.id());
    glRenderbufferStorageMultisample(GL_RENDERBUFFER, samples, GL_RGBA8, width, height);
    glGetRenderbufferParameteriv(GL_RENDERBUFFER, GL_RENDERBUFFER_SAMPLES, &f.samples_);
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_RENDERBUFFER,
                              f.color_samples_.id());
  } else {
    glActiveTexture(GL_TEXTURE0);
    f.color_ = nearest_texture();
    store_rgba(false, width, height);
    glBindTexture(GL_TEXTURE_2D, 0);
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, f.color_.id(), 0);
  }
  glBindRenderbuffer(GL_RENDERBUFFER, f.depth_stencil_.id());
  // With 0 samples this is glRenderbufferStorage().
  glRenderbufferStorageMultisample(GL_RENDERBUFFER, samples, GL_DEPTH24_STENCIL8, width, height);
  glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_DEPTH_STENCIL_ATTACHMENT, GL_RENDERBUFFER,
                            f.depth_stencil_.id());
  const GLenum status = glCheckFramebufferStatus(GL_FRAMEBUFFER);
  if (status != GL_FRAMEBUFFER_COMPLETE) {
    return fail("the graphics driver refuses a framebuffer of {} x {} px (status {:#x})", width,
                height, status);
  }
  return f;
}

void Framebuffer::bind() const {
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glViewport(0, 0, width_, height_);
}

void Framebuffer::make_sums() {
  sums_framebuffer_ = FramebufferHandle::create();
  const auto store = [this](bool half_floats) {
    sums_are_half_floats_ = half_floats;
    if (samples_ > 0) {
      glRenderbufferStorageMultisample(GL_RENDERBUFFER, samples_,
                                       half_floats ? GL_RGBA16F : GL_RGBA8, width_, height_);
    } else {
      store_rgba(half_floats, width_, height_);
    }
  };
  if (samples_ > 0) {
    sums_samples_ = RenderbufferHandle::create();
    glBindFramebuffer(GL_FRAMEBUFFER, sums_framebuffer_.id());
    glBindRenderbuffer(GL_RENDERBUFFER, sums_samples_.id());
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_RENDERBUFFER,
                              sums_samples_.id());
  } else {
    glActiveTexture(GL_TEXTURE0);
    sums_ = nearest_texture();
    glBindFramebuffer(GL_FRAMEBUFFER, sums_framebuffer_.id());
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, sums_.id(), 0);
  }
  glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_DEPTH_STENCIL_ATTACHMENT, GL_RENDERBUFFER,
                            depth_stencil_.id());
  store(true);
  if (glCheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) store(false);
}

void Framebuffer::bind_sums() {
  if (!sums_framebuffer_) make_sums();
  // The texture that is drawn into must not be bound for reading.
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, 0);
  glBindFramebuffer(GL_FRAMEBUFFER, sums_framebuffer_.id());
  glViewport(0, 0, width_, height_);
  clear_color(0.0F);
}

void Framebuffer::bind_sums_texture(int unit) {
  PENUMBRA_ASSERT(static_cast<bool>(sums_framebuffer_));
  if (samples_ > 0) {
    copy_sums(unit);
    glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
    return;
  }
  glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
  glBindTexture(GL_TEXTURE_2D, sums_.id());
}

void Framebuffer::copy_image(int unit) {
  copy(framebuffer_.id(), image_copy_, false, unit);
}

void Framebuffer::copy_sums(int unit) {
  PENUMBRA_ASSERT(static_cast<bool>(sums_framebuffer_));
  copy(sums_framebuffer_.id(), sums_copy_, sums_are_half_floats_, unit);
}

void Framebuffer::copy_image_reduced(int unit) {
  const ImageSize quarter{std::max(1, width_ / 4), std::max(1, height_ / 4)};
  const unsigned from = resolved();
  glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
  Copy& to = reduced_copy_;
  if (!to.framebuffer) {
    to = make_copy(quarter, false);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  }
  blit(from, {width_, height_}, to.framebuffer.id(), quarter, GL_LINEAR);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glBindTexture(GL_TEXTURE_2D, to.texture.id());
  glGenerateMipmap(GL_TEXTURE_2D);
}

Framebuffer::Copy Framebuffer::make_copy(ImageSize size, bool half_floats) {
  Copy copy;
  copy.texture = nearest_texture();
  store_rgba(half_floats, size.width, size.height);
  copy.framebuffer = FramebufferHandle::create();
  glBindFramebuffer(GL_FRAMEBUFFER, copy.framebuffer.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, copy.texture.id(), 0);
  return copy;
}

void Framebuffer::copy(unsigned from, Copy& to, bool half_floats, int unit) const {
  glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
  if (!to.framebuffer) to = make_copy({width_, height_}, half_floats);
  blit(from, {width_, height_}, to.framebuffer.id(), {width_, height_}, GL_NEAREST);
  glBindFramebuffer(GL_FRAMEBUFFER, from);
  glBindTexture(GL_TEXTURE_2D, to.texture.id());
}

void Framebuffer::read_rgba(std::span<std::uint8_t> rgba) const {
  PENUMBRA_ASSERT(rgba.size() == std::size_t{4} * static_cast<std::size_t>(width_) *
                                     static_cast<std::size_t>(height_));
  read(rgba.data());
}

void Framebuffer::read_rgba_to_buffer() const {
  read(nullptr);
}

void Framebuffer::read(void* rgba) const {
  glBindFramebuffer(GL_READ_FRAMEBUFFER, resolved());
  glPixelStorei(GL_PACK_ALIGNMENT, 1);
  glReadPixels(0, 0, width_, height_, GL_RGBA, GL_UNSIGNED_BYTE, rgba);
}

void Framebuffer::read_part(const PixelRect& part, std::span<std::uint8_t> rgba,
                            std::span<std::uint32_t> depth_stencil) const {
  [[maybe_unused]] const std::size_t pixels =
      static_cast<std::size_t>(part.width) * static_cast<std::size_t>(part.height);
  PENUMBRA_ASSERT(samples_ == 0 && rgba.size() == 4 * pixels && depth_stencil.size() == pixels);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer_.id());
  glPixelStorei(GL_PACK_ALIGNMENT, 4);
  glReadPixels(part.x, part.y, part.width, part.height, GL_RGBA, GL_UNSIGNED_BYTE, rgba.data());
  glReadPixels(part.x, part.y, part.width, part.height, GL_DEPTH_STENCIL, GL_UNSIGNED_INT_24_8,
               depth_stencil.data());
}

void Framebuffer::write_part(const PixelRect& part, std::span<const std::uint8_t> rgba) {
  PENUMBRA_ASSERT(samples_ == 0);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, color_.id());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 4);
  glPixelStorei(GL_UNPACK_ROW_LENGTH, 0);
  glTexSubImage2D(GL_TEXTURE_2D, 0, part.x, part.y, part.width, part.height, GL_RGBA,
                  GL_UNSIGNED_BYTE, rgba.data());
  // A texture that is drawn into must not be bound for reading.
  glBindTexture(GL_TEXTURE_2D, 0);
}

unsigned Framebuffer::resolved() const {
  if (samples_ == 0) return framebuffer_.id();
  copy(framebuffer_.id(), resolved_, false, 0);
  return resolved_.framebuffer.id();
}

void Framebuffer::invalidate_depth_stencil() const {
  if (epoxy_is_desktop_gl() && epoxy_gl_version() < 43) return;
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  const GLenum attachment = GL_DEPTH_STENCIL_ATTACHMENT;
  glInvalidateFramebuffer(GL_FRAMEBUFFER, 1, &attachment);
}

void Framebuffer::clear() const {
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  clear_color(1.0F);
}

void Framebuffer::present(GlContext::Size window) const {
  show(resolved(), width_, height_, window);
}

Result<UploadedImage> UploadedImage::create(int width, int height) {
  GLint largest = 0;
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &largest);
  if (width > largest || height > largest) return too_large(width, height, largest);
  UploadedImage uploaded;
  uploaded.width_ = width;
  uploaded.height_ = height;
  uploaded.texture_ = nearest_texture();
  store_rgba(false, width, height);
  uploaded.framebuffer_ = FramebufferHandle::create();
  glBindFramebuffer(GL_FRAMEBUFFER, uploaded.framebuffer_.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D,
                         uploaded.texture_.id(), 0);
  return uploaded;
}

void UploadedImage::present(std::span<const std::uint8_t> rgba, GlContext::Size window) {
  PENUMBRA_ASSERT(rgba.size() == std::size_t{4} * static_cast<std::size_t>(width_) *
                                     static_cast<std::size_t>(height_));
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, texture_.id());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 4);
  glPixelStorei(GL_UNPACK_ROW_LENGTH, 0);
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, width_, height_, GL_RGBA, GL_UNSIGNED_BYTE, rgba.data());
  show(framebuffer_.id(), width_, height_, window);
}

}  // namespace penumbra
