// The unit square in pieces, for rectangles that follow a curved lens.
#pragma once

#include <array>
#include <cstddef>

#include "render/gl/buffer.hpp"

namespace penumbra {

class UnitGrids {
 public:
  // Corners, 0 to 1, feed layout(location = 0) of the programs.
  UnitGrids();

  // The square as large as `longest` [m], in pieces no longer than `piece`, or than 1/64 of it; one
  // piece where `straight`.
  void draw(double longest, double piece, bool straight) const;

 private:
  // 2^i by 2^i pieces.
  struct Grid {
    VertexArray layout;
    GlBuffer vertices{BufferUse::vertices};
    GlBuffer indices{BufferUse::indices};
    int index_count = 0;
  };
  static constexpr std::size_t kGrids = 7;  // up to 64 x 64
  std::array<Grid, kGrids> grids_;
};

}  // namespace penumbra
