#include "render/gl/buffer.hpp"

#include <epoxy/gl.h>

namespace penumbra {
namespace {

GLenum target_of(BufferUse use) {
  return use == BufferUse::vertices ? GL_ARRAY_BUFFER : GL_ELEMENT_ARRAY_BUFFER;
}

}  // namespace

void GlBuffer::write(std::span<const std::byte> bytes, BufferLife life) {
  bind();
  glBufferData(target_of(use_), static_cast<GLsizeiptr>(bytes.size()), bytes.data(),
               life == BufferLife::once ? GL_STATIC_DRAW : GL_STREAM_DRAW);
}

void GlBuffer::bind() const {
  glBindBuffer(target_of(use_), handle_.id());
}

void VertexArray::bind() const {
  glBindVertexArray(handle_.id());
}

void VertexArray::attribute(unsigned index, int count, std::size_t stride, std::size_t offset) {
  glEnableVertexAttribArray(index);
  glVertexAttribPointer(index, count, GL_FLOAT, GL_FALSE, static_cast<GLsizei>(stride),
                        reinterpret_cast<const void*>(offset));
}

}  // namespace penumbra
