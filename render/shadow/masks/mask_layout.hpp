// Lays out the masks of a plane: the cells of each mask, and which casters ("parts") share it.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

namespace penumbra {

// Square cells of a plane. Corners lie at integer multiples of the cell size, so that the coverage
// of a cell by one mesh does not depend on other casters.
struct MaskCells {
  double size = 0.0;          // [m]
  std::int64_t u = 0, v = 0;  // the first cell, in cells from the plane's origin
  int width = 0, height = 0;
  friend bool operator==(const MaskCells&, const MaskCells&) = default;
};

// A box of cells, from the first to the last, both inclusive.
using CellBox = Eigen::AlignedBox<std::int64_t, 2>;

// Returns 2^(half_octave / 2) [m].
[[nodiscard]] double cell_size(int half_octave);

// The part of a rectangle on the plane that is visible to a camera.
struct VisiblePart {
  Eigen::AlignedBox2d box;  // bounds [m]; empty: not visible
  int half_octave = 0;      // required cell size: cell_size(half_octave)
};

// No part overlaps the cells of two masks, so at any point one mask has the darkest layer.
struct MaskLayout {
  struct Group {
    std::vector<std::size_t> parts;
    MaskCells cells;
    bool cut = false;  // clipped to the visible region: parts may extend beyond the cells
    friend bool operator==(const Group&, const Group&) = default;
  };
  std::vector<Group> groups;
  bool of_view = false;  // depends on the visible region
  friend bool operator==(const MaskLayout&, const MaskLayout&) = default;
};
// Lays out one mask if all parts fit into a mask of moderate size, else one mask for each group of
// overlapping parts. The mask of a large group is clipped to its visible region and has the cell
// size that this region needs, or larger cells if there would be too many. `bounds`: bounds of each
// part in cells of `half_octave`; `max_side`: maximum number of cells along a side of a mask.
[[nodiscard]] MaskLayout lay_out_masks(
    std::span<const CellBox> bounds, int half_octave, std::int64_t max_side,
    const std::function<VisiblePart(const Eigen::AlignedBox2d&)>& visible);

}  // namespace penumbra
