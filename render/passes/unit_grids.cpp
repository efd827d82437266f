#include "render/passes/unit_grids.hpp"

#include <epoxy/gl.h>

#include <cstdint>
#include <glm/vec2.hpp>
#include <span>
#include <vector>

namespace penumbra {

UnitGrids::UnitGrids() {
  for (std::size_t i = 0; i < kGrids; ++i) {
    Grid& grid = grids_[i];
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
    grid.layout.bind();
    grid.vertices.write(std::span<const glm::vec2>(corners));
    bind_corners(i);
    grid.indices.write(std::span<const std::uint32_t>(indices));
    grid.index_count = static_cast<int>(indices.size());
  }
}

std::array<std::uint32_t, 6> UnitGrids::piece(std::size_t grid, std::uint32_t row,
                                              std::uint32_t column) {
  const std::uint32_t corners = (1U << grid) + 1;
  const std::uint32_t first = row * corners + column;
  const std::uint32_t above = first + corners;
  return {first, first + 1, above, above, first + 1, above + 1};
}

std::size_t UnitGrids::grid_for(double longest, double piece, bool straight) {
  std::size_t grid = 0;
  while (!straight && grid + 1 < kGrids && longest > piece * static_cast<double>(1U << grid))
    ++grid;
  return grid;
}

void UnitGrids::draw(std::size_t grid) const {
  grids_[grid].layout.bind();
  glDrawElements(GL_TRIANGLES, grids_[grid].index_count, GL_UNSIGNED_INT, nullptr);
}

void UnitGrids::bind_corners(std::size_t grid) const {
  grids_[grid].vertices.bind();
  VertexArray::attribute(0, 2, sizeof(glm::vec2), 0);
}

}  // namespace penumbra
