#include "render/gl/mask_stack.hpp"

#include <epoxy/gl.h>

#include <algorithm>

namespace penumbra {
namespace {

// OpenGL 3.3 and OpenGL ES 3.0 guarantee 4 samples if the driver supports multisampling.
constexpr int kMaxSamples = 4;

}  // namespace

MaskStack::MaskStack()
    : framebuffer_(FramebufferHandle::create()), texture_(TextureHandle::create()) {
  GLint max_samples = 0;
  glGetIntegerv(GL_MAX_SAMPLES, &max_samples);
  sample_count_ = std::min(kMaxSamples, max_samples);
  if (sample_count_ <= 1) sample_count_ = 0;
  if (sample_count_ > 0) {
    samples_framebuffer_ = FramebufferHandle::create();
    samples_ = RenderbufferHandle::create();
  }
  bind(0);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  unbind(0);
}

void MaskStack::resize(int width, int height, int count) {
  if (width == width_ && height == height_ && count == count_) return;
  width_ = width;
  height_ = height;
  count_ = count;
  bind(0);
  glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, GL_RGBA8, width, height, count, 0, GL_RGBA, GL_UNSIGNED_BYTE,
               nullptr);
  unbind(0);
}

void MaskStack::upload(int index, std::span<const std::uint8_t> rgba) const {
  bind(0);
  glPixelStorei(GL_UNPACK_ALIGNMENT, 4);
  glTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, 0, 0, index, width_, height_, 1, GL_RGBA,
                  GL_UNSIGNED_BYTE, rgba.data());
  unbind(0);
}

void MaskStack::begin(int index) {
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glFramebufferTextureLayer(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, texture_.id(), 0, index);
  if (sample_count_ > 0) {
    glBindFramebuffer(GL_FRAMEBUFFER, samples_framebuffer_.id());
    if (samples_width_ != width_ || samples_height_ != height_) {
      samples_width_ = width_;
      samples_height_ = height_;
      glBindRenderbuffer(GL_RENDERBUFFER, samples_.id());
      glRenderbufferStorageMultisample(GL_RENDERBUFFER, sample_count_, GL_RGBA8, width_, height_);
      glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_RENDERBUFFER,
                                samples_.id());
    }
  }
  glViewport(0, 0, width_, height_);
  glDisable(GL_SCISSOR_TEST);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glClearColor(0.0F, 0.0F, 0.0F, 0.0F);
  glClear(GL_COLOR_BUFFER_BIT);
}

void MaskStack::end() const {
  if (sample_count_ == 0) return;
  glBindFramebuffer(GL_READ_FRAMEBUFFER, samples_framebuffer_.id());
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, framebuffer_.id());
  glBlitFramebuffer(0, 0, width_, height_, 0, 0, width_, height_, GL_COLOR_BUFFER_BIT, GL_NEAREST);
}

void MaskStack::bind(int unit) const {
  glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
  glBindTexture(GL_TEXTURE_2D_ARRAY, texture_.id());
}

void MaskStack::unbind(int unit) {
  glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
  glBindTexture(GL_TEXTURE_2D_ARRAY, 0);
}

}  // namespace penumbra
