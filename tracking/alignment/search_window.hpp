// Maps of scores of the pattern search, and the peaks in them.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>

#include "tracking/alignment/aligned_tag.hpp"

namespace penumbra {

// The middle of a peak's top in a map of scores [its rows and columns].
struct SearchTop {
  double row = 0.0;
  double column = 0.0;
  bool open = false;  // may go on beyond the map
};

// The displacements of a search, and the rows of its maps of scores: every row_step-th one.
struct SearchWindow {
  static constexpr int kRim_px = 2;  // a peak at the rim of a window may be the flank of another

  int reach = 0;    // [pixels of the searched image]
  int columns = 0;  // one more than displacements, which fills the lanes of the SIMD loops
  int rows = 0;
  int row_step = 1;
  int first_row = 0;  // displacement of the first row

  [[nodiscard]] static SearchWindow of_reach(int reach, int row_step);
  [[nodiscard]] int size() const { return rows * columns; }
  // True if a peak at this distance would lie well inside the window.
  [[nodiscard]] bool holds(double px) const { return px + kRim_px <= std::min(reach, -first_row); }
  [[nodiscard]] Eigen::Vector2d displacement(const SearchTop& top) const {
    return {top.column - reach, first_row + row_step * top.row};
  }
  // The middle of the top about the highest place of a map, where a cell is `cell` places wide.
  [[nodiscard]] SearchTop top_about(std::span<const std::int32_t> scores, int row, int column,
                                    double cell) const;
  [[nodiscard]] SearchTop top_about(std::span<const std::int16_t> scores, int row, int column,
                                    double cell) const;
};

// The highest place of a tag's own map within `slack` of another one.
struct OwnPeak {
  int row = 0, column = 0;
};
// Nothing where the pattern is not seen with this contrast (white over black cells [grey]), or
// where the highest place is on the flank of what is further off.
[[nodiscard]] std::optional<OwnPeak> own_peak(const AlignedTag& tag, const SearchWindow& window,
                                              OwnPeak about, int slack, double least_contrast);

}  // namespace penumbra
