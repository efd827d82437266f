#include "render/passes/layers/unit_grids.hpp"

#include <epoxy/gl.h>

#include <glm/vec2.hpp>

namespace penumbra {

UnitGrids::UnitGrids() {
  for (std::size_t i = 0; i < kGrids; ++i) {
    const std::uint32_t pieces = 1U << i;
    std::vector<glm::vec2> corners;
    std::vector<std::uint32_t> indices;
    for (std::uint32_t row = 0; row <= pieces; ++row) {
      for (std::uint32_t column = 0; column <= pieces; ++column) {
        corners.emplace_back(static_cast<float>(column) / static_cast<float>(pieces),
                             static_cast<float>(row) / static_cast<float>(pieces));
        if (row == pieces || column == pieces) continue;
        for (const std::uint32_t index : piece(i, row, column)) indices.push_back(index);
      }
    }
    GlMesh& grid = grids_.emplace_back(GlMesh{2});
    grid.write(corners);
    grid.write_indices(indices);
  }
}

std::size_t UnitGrids::grid_for(double longest, double piece, bool straight) {
  std::size_t grid = 0;
  while (!straight && grid + 1 < kGrids && longest > piece * static_cast<double>(1U << grid))
    ++grid;
  return grid;
}

void UnitGrids::draw(std::size_t grid) const {
  grids_[grid].draw(GL_TRIANGLES);
}

void UnitGrids::bind_corners(std::size_t grid) const {
  grids_[grid].bind_vertices();
  VertexArray::attributes({2});
}

}  // namespace penumbra
