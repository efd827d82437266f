#include "render/gl/pixel_buffer.hpp"

#include <epoxy/gl.h>

#include <algorithm>

#include "core/assert.hpp"

namespace penumbra {

void PixelBuffer::bind(unsigned target, std::size_t size, unsigned usage) {
  if (!handle) handle = BufferHandle::create();
  glBindBuffer(target, handle.id());
  if (bytes == size) return;
  glBufferData(target, static_cast<GLsizeiptr>(size), nullptr, usage);
  bytes = size;
}

std::span<std::uint8_t> UploadBuffers::map(std::size_t bytes) {
  buffers_[next_].bind(GL_PIXEL_UNPACK_BUFFER, bytes, GL_STREAM_DRAW);
  next_ = (next_ + 1) % buffers_.size();
  void* start = glMapBufferRange(GL_PIXEL_UNPACK_BUFFER, 0, static_cast<GLsizeiptr>(bytes),
                                 GL_MAP_WRITE_BIT | GL_MAP_INVALIDATE_BUFFER_BIT);
  if (start == nullptr) {
    unbind();
    return {};
  }
  return {static_cast<std::uint8_t*>(start), bytes};
}

bool UploadBuffers::unmap() {
  if (glUnmapBuffer(GL_PIXEL_UNPACK_BUFFER) == GL_TRUE) return true;
  unbind();
  return false;
}

void UploadBuffers::unbind() {
  glBindBuffer(GL_PIXEL_UNPACK_BUFFER, 0);
}

void ReadBackBuffers::ask(const Framebuffer& image, std::size_t bytes) {
  PENUMBRA_ASSERT(pending_ < kMaxPending);
  buffers_[(first_ + pending_) % kMaxPending].bind(GL_PIXEL_PACK_BUFFER, bytes, GL_STREAM_READ);
  image.read_rgba_to_buffer();
  glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);
  ++pending_;
}

void ReadBackBuffers::drop_last() {
  PENUMBRA_ASSERT(pending_ > 0);
  --pending_;
}

Result<void> ReadBackBuffers::take(std::span<std::uint8_t> rgba) {
  PENUMBRA_ASSERT(pending_ > 0);
  const PixelBuffer& buffer = buffers_[first_];
  PENUMBRA_ASSERT(buffer.bytes == rgba.size());
  first_ = (first_ + 1) % kMaxPending;
  --pending_;
  glBindBuffer(GL_PIXEL_PACK_BUFFER, buffer.handle.id());
  const void* start = glMapBufferRange(GL_PIXEL_PACK_BUFFER, 0,
                                       static_cast<GLsizeiptr>(rgba.size()), GL_MAP_READ_BIT);
  bool complete = start != nullptr;
  if (complete) {
    std::copy_n(static_cast<const std::uint8_t*>(start), rgba.size(), rgba.data());
    complete = glUnmapBuffer(GL_PIXEL_PACK_BUFFER) == GL_TRUE;
  }
  glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);
  if (!complete) {
    return fail(
        "the graphics driver lost an image while it was read back; use --pixel-buffers off");
  }
  return {};
}

}  // namespace penumbra
