// How the masks of a plane are laid out: their cells, and which parts share one.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

namespace penumbra {

// Square cells of the plane whose corners are at whole multiples of their size: what a mesh covers
// of a cell does not depend on what else is drawn.
struct MaskCells {
  double size = 0.0;          // [m]
  std::int64_t u = 0, v = 0;  // of the first cell, in cells from the plane's origin
  int width = 0, height = 0;
  friend bool operator==(const MaskCells&, const MaskCells&) = default;
};

// Boxes of whole cells, first and last.
using CellBox = Eigen::AlignedBox<std::int64_t, 2>;

// The sides of cells, by half powers of two [m].
[[nodiscard]] double cell_size(int half_octave);

// The part of a rectangle on the plane that a camera sees.
struct SeenPart {
  Eigen::AlignedBox2d box;  // that holds it [m]; empty: nothing is seen
  int half_octave = 0;      // of cells as fine as it asks for
};

// Which parts share a mask, and of which cells it is. No part is in two masks' cells, so that the
// darkest layer of any place is in one of them.
struct MaskLayout {
  struct Group {
    std::vector<std::size_t> parts;
    MaskCells cells;
    bool cut = false;  // to what is seen: parts may reach beyond the cells
    friend bool operator==(const Group&, const Group&) = default;
  };
  std::vector<Group> groups;
  bool of_view = false;  // depends on the visible part
  friend bool operator==(const MaskLayout&, const MaskLayout&) = default;
};
// Lays out one mask where all parts fit into one of moderate size. Else one for each group of parts
// that lie together, cut to the visible part where the group is large, of cells as fine as that
// part asks for; coarser only where there would be too many. `bounds`: of each part, in cells of
// `half_octave`; `most`: cells along a side that a mask can have.
[[nodiscard]] MaskLayout lay_out_masks(
    std::span<const CellBox> bounds, int half_octave, std::int64_t most,
    const std::function<SeenPart(const Eigen::AlignedBox2d&)>& seen);

}  // namespace penumbra
