// Vertex and index buffers, and the vertex arrays that say how they are read.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "render/gl/handle.hpp"

namespace penumbra {

enum class BufferUse { vertices, indices };
enum class BufferLife { once, every_frame };  // how often it is written

class GlBuffer {
 public:
  explicit GlBuffer(BufferUse use) : use_(use), handle_(GlHandle<BufferTraits>::create()) {}

  // Replaces the contents. An index buffer is bound into the vertex array that is bound now.
  void write(std::span<const std::byte> bytes, BufferLife life = BufferLife::once);
  template <class T>
  void write(std::span<const T> values, BufferLife life = BufferLife::once) {
    write(std::as_bytes(values), life);
  }
  void bind() const;

 private:
  BufferUse use_;
  GlHandle<BufferTraits> handle_;
};

class VertexArray {
 public:
  VertexArray() : handle_(GlHandle<VertexArrayTraits>::create()) {}
  void bind() const;
  // `count` floats of the vertex buffer bound now, at `offset` bytes into each `stride` bytes, feed
  // layout(location = index). This array must be bound.
  static void attribute(unsigned index, int count, std::size_t stride, std::size_t offset);

 private:
  GlHandle<VertexArrayTraits> handle_;
};

}  // namespace penumbra
