// The unit square divided into pieces, for rectangles that follow the lens.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "render/gl/buffer.hpp"

namespace penumbra {

class UnitGrids {
 public:
  // Corners, with coordinates 0 to 1, are the attribute layout(location = 0).
  UnitGrids();

  static constexpr std::size_t kGrids = 7;  // grid i has 2^i x 2^i pieces, up to 64 x 64
  // Returns the coarsest grid that divides a square of side `longest` [m] into pieces no longer
  // than `piece`, or else the finest grid; grid 0 if `straight`.
  [[nodiscard]] static std::size_t grid_for(double longest, double piece, bool straight);

  void draw(std::size_t grid) const;
  // Sets the bound vertex array's attribute to the grid's corners, row by row.
  void bind_corners(std::size_t grid) const;
  // Returns the indices of a piece's two triangles.
  [[nodiscard]] static std::array<std::uint32_t, 6> piece(std::size_t grid, std::uint32_t row,
                                                          std::uint32_t column) {
    const std::uint32_t corners = (1U << grid) + 1;
    return cell_indices(row * corners + column, corners);
  }

 private:
  std::vector<GlMesh> grids_;
};

}  // namespace penumbra
