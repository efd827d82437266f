// The layout of a plane's masks: their cells, and which parts share one.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

namespace penumbra {

// Square cells of the plane whose corners are at whole multiples of their size: the part of a cell
// that a mesh covers does not depend on other casters.
struct MaskCells {
  double size = 0.0;          // [m]
  std::int64_t u = 0, v = 0;  // the first cell, in cells from the plane's origin
  int width = 0, height = 0;
  friend bool operator==(const MaskCells&, const MaskCells&) = default;
};

// Boxes of whole cells, first and last.
using CellBox = Eigen::AlignedBox<std::int64_t, 2>;

// 2^(half_octave / 2) [m].
[[nodiscard]] double cell_size(int half_octave);

// The part of a rectangle on the plane that a camera sees.
struct VisiblePart {
  Eigen::AlignedBox2d box;  // its bounds [m]; empty: nothing is seen
  int half_octave = 0;      // of the cells that it needs
};

// No part is in the cells of two masks, so that the darkest layer of any place is in one of them.
struct MaskLayout {
  struct Group {
    std::vector<std::size_t> parts;
    MaskCells cells;
    bool cut = false;  // to the visible part: parts may reach beyond the cells
    friend bool operator==(const Group&, const Group&) = default;
  };
  std::vector<Group> groups;
  bool of_view = false;  // depends on the visible part
  friend bool operator==(const MaskLayout&, const MaskLayout&) = default;
};
// Lays out one mask where all parts fit into one of moderate size. Else one mask for each group of
// parts that lie together, cut to the visible part where the group is large, of cells as fine as
// that part needs; coarser only where there would be too many. `bounds`: of each part, in cells of
// `half_octave`; `most`: the most cells along a side of a mask.
[[nodiscard]] MaskLayout lay_out_masks(
    std::span<const CellBox> bounds, int half_octave, std::int64_t most,
    const std::function<VisiblePart(const Eigen::AlignedBox2d&)>& seen);

}  // namespace penumbra
