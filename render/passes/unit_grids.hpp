// The unit square in pieces, for rectangles that follow a curved lens.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "render/gl/buffer.hpp"

namespace penumbra {

class UnitGrids {
 public:
  // Corners, 0 to 1, feed layout(location = 0) of the programs.
  UnitGrids();

  static constexpr std::size_t kGrids = 7;  // the i-th has 2^i by 2^i pieces: up to 64 x 64
  // The coarsest that has a square as large as `longest` [m] in pieces no longer than `piece`, or
  // the finest; the first where `straight`.
  [[nodiscard]] static std::size_t grid_for(double longest, double piece, bool straight);

  void draw(std::size_t grid) const;
  // For a vertex array of the caller's, bound now: the grid's corners, row by row.
  void bind_corners(std::size_t grid) const;
  // Two triangles of the piece in a row and a column.
  [[nodiscard]] static std::array<std::uint32_t, 6> piece(std::size_t grid, std::uint32_t row,
                                                          std::uint32_t column);

 private:
  struct Grid {
    VertexArray layout;
    GlBuffer vertices{BufferUse::vertices};
    GlBuffer indices{BufferUse::indices};
    int index_count = 0;
  };
  std::array<Grid, kGrids> grids_;
};

}  // namespace penumbra
