// Vertex and index buffers, and the vertex arrays that read them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <span>
#include <vector>

#include "render/gl/handle.hpp"

namespace penumbra {

enum class BufferUse { vertices, indices };
enum class BufferLife { once, every_frame };  // how often the buffer is written

class GlBuffer {
 public:
  explicit GlBuffer(BufferUse use) : use_(use), handle_(BufferHandle::create()) {}

  // Replaces the contents. An index buffer becomes the index buffer of the bound vertex array.
  void write(std::span<const std::byte> bytes, BufferLife life = BufferLife::once);
  template <class T>
  void write(std::span<const T> values, BufferLife life = BufferLife::once) {
    write(std::as_bytes(values), life);
  }
  void bind() const;

 private:
  BufferUse use_;
  BufferHandle handle_;
};

class VertexArray {
 public:
  VertexArray() : handle_(VertexArrayHandle::create()) {}
  void bind() const;
  // Sets the vertex attribute layout(location = index) of the bound array: `count` floats of the
  // bound vertex buffer, at byte `offset` of each `stride` bytes.
  static void attribute(unsigned index, int count, std::size_t stride, std::size_t offset);
  // Sets the attributes of consecutive locations from `first` on, tightly packed floats. `counts`:
  // floats of each location; `offset`: bytes before the first vertex.
  static void attributes(std::initializer_list<int> counts, unsigned first = 0,
                         std::size_t offset = 0);

 private:
  VertexArrayHandle handle_;
};

// A vertex array with a vertex buffer and an index buffer.
class GlMesh {
 public:
  // `counts`: floats per vertex at layout(location = 0), 1, ...
  explicit GlMesh(std::initializer_list<int> counts);

  template <class Vertex>
  void write(const std::vector<Vertex>& vertices, BufferLife life = BufferLife::once) {
    layout_.bind();
    vertices_.write(std::as_bytes(std::span(vertices)), life);
    count_ = static_cast<int>(vertices.size());
  }
  // Makes draw() use these indices. Call it after write().
  void write_indices(std::span<const std::uint32_t> indices, BufferLife life = BufferLife::once);
  void bind() const { layout_.bind(); }
  void bind_vertices() const { vertices_.bind(); }
  // Draw all indices, or `count` indices from `first` on; without indices, vertices.
  void draw(unsigned mode) const { draw(mode, 0, count_); }
  void draw(unsigned mode, int first, int count) const;
  [[nodiscard]] int count() const { return count_; }

 private:
  VertexArray layout_;
  GlBuffer vertices_{BufferUse::vertices};
  GlBuffer indices_{BufferUse::indices};
  bool indexed_ = false;
  int count_ = 0;  // number of indices, or of vertices if not indexed
};

// Indices of the two triangles of a cell in a grid of vertices, row by row. `first`: the cell's
// first corner; `row_length`: vertices in a row.
[[nodiscard]] inline std::array<std::uint32_t, 6> cell_indices(std::uint32_t first,
                                                               std::uint32_t row_length) {
  const std::uint32_t next = first + row_length;
  return {first, first + 1, next, next, first + 1, next + 1};
}

}  // namespace penumbra
