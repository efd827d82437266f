// The printed cells of a tag and the edges between them, on the tag's lattice. Lattice coordinates
// (a, b) [cells]: origin at the lower left corner of the whole printed square (including the white
// margin), a right and b up on the upright tag. Cell (i, j) covers [i, i + 1] x [j, j + 1]. Cells
// of a tag of `size_m` are size_m / width_at_border wide; the tag frame's origin (its centre) is at
// (total_width / 2, total_width / 2).
#pragma once

#include <cstdint>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"

namespace penumbra {

// A maximal straight edge between black and white cells with one polarity.
struct EdgeRun {
  bool vertical = false;  // true: a = position, b in [begin, end]; false: swap a and b
  int position = 0;
  int begin = 0;
  int end = 0;
  int polarity = 0;  // +1: white on the side of larger a (or b); -1: black
};

struct DataCell {
  int i = 0;
  int j = 0;
  bool white = false;
};

class TagPattern {
 public:
  // Fails when the family has no such id.
  [[nodiscard]] static Result<TagPattern> make(TagFamily family, int id);

  [[nodiscard]] int width_at_border() const { return width_at_border_; }  // [cells]
  [[nodiscard]] int total_width() const { return total_width_; }          // [cells]
  // Returns the colour of a cell; white outside the printed square.
  [[nodiscard]] bool white(int i, int j) const {
    if (i < 0 || j < 0 || i >= total_width_ || j >= total_width_) return true;
    return cells_[static_cast<std::size_t>(j * total_width_ + i)] != 0;
  }
  // Returns true if the family defines the cell.
  [[nodiscard]] bool printed(int i, int j) const {
    if (i < 0 || j < 0 || i >= total_width_ || j >= total_width_) return false;
    return printed_[static_cast<std::size_t>(j * total_width_ + i)] != 0;
  }
  // All edges inside the printed square, without its outline: the surroundings are unknown.
  [[nodiscard]] const std::vector<EdgeRun>& runs() const { return runs_; }
  [[nodiscard]] const std::vector<DataCell>& data_cells() const { return data_cells_; }

 private:
  int width_at_border_ = 0;
  int total_width_ = 0;
  std::vector<std::uint8_t> cells_;    // rows from the bottom, 1 = white
  std::vector<std::uint8_t> printed_;  // same order, 1 = printed
  std::vector<EdgeRun> runs_;
  std::vector<DataCell> data_cells_;
};

}  // namespace penumbra
