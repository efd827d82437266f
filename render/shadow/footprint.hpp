// A silhouette as a raster: triangles seen along a direction, one byte per cell, and how far each
// cell is from the outside.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

namespace penumbra {

// Cells are square; cell (column, row) has its centre at origin + (column + 0.5, row + 0.5) cell.
struct Footprint {
  int width = 0;      // [cells]
  int height = 0;     // [cells]
  double cell = 0.0;  // [m]
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();
  std::vector<std::uint8_t> covered;  // row after row, 1 where the cell's centre is covered

  [[nodiscard]] Eigen::Vector2d centre(int column, int row) const {
    return origin + cell * Eigen::Vector2d(column + 0.5, row + 0.5);
  }
};

// A raster with an empty margin of one cell on each side, its longer side about `cells` cells.
// `faces` holds three indices into `points` per triangle. Points must be finite. Empty (0 x 0)
// where the points have no extent.
[[nodiscard]] Footprint rasterise_footprint(std::span<const Eigen::Vector2d> points,
                                            std::span<const std::uint32_t> faces, int cells);

// Area centroid of the covered cells, or of the points where no cell is covered.
[[nodiscard]] Eigen::Vector2d footprint_centroid(const Footprint& footprint,
                                                 std::span<const Eigen::Vector2d> points);

}  // namespace penumbra
