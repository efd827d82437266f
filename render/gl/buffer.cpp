#include "render/gl/buffer.hpp"

#include <epoxy/gl.h>

#include <numeric>

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

void VertexArray::attributes(std::initializer_list<int> counts, unsigned first,
                             std::size_t offset) {
  const std::size_t stride = sizeof(float) * std::accumulate(counts.begin(), counts.end(), 0U);
  for (const int count : counts) {
    attribute(first++, count, stride, offset);
    offset += sizeof(float) * static_cast<std::size_t>(count);
  }
}

GlMesh::GlMesh(std::initializer_list<int> counts) {
  layout_.bind();
  vertices_.bind();
  VertexArray::attributes(counts);
}

void GlMesh::write_indices(std::span<const std::uint32_t> indices, BufferLife life) {
  layout_.bind();
  indices_.write(indices, life);
  indexed_ = true;
  count_ = static_cast<int>(indices.size());
}

void GlMesh::draw(unsigned mode, int first, int count) const {
  layout_.bind();
  if (indexed_) {
    glDrawElements(
        mode, count, GL_UNSIGNED_INT,
        reinterpret_cast<const void*>(sizeof(std::uint32_t) * static_cast<std::size_t>(first)));
  } else {
    glDrawArrays(mode, first, count);
  }
}

}  // namespace penumbra
