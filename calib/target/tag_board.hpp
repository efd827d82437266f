// A sheet with a grid of tags: its size and its tag map. Drawing it is target_sheet.hpp.
#pragma once

#include <optional>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"

namespace penumbra {

// Grid of tags; ids count in reading order from the top left. The table frame's origin is the
// board's centre, x right, y up on the sheet, z out of the paper.
struct TagBoard {
  TagFamily family = TagFamily::tag36h11;
  int first_id = 0;
  int columns = 4;
  int rows = 3;
  double tag_size_m = 0.04;  // edge of the black border's outer square
  double pitch_m = 0.055;    // distance between neighbouring tags' centres
};

// Rounds a length [m] down to whole millimetres.
[[nodiscard]] double whole_mm_below(double length_m);

// Returns the width of a tag with its white margin over its size.
[[nodiscard]] Result<double> printed_ratio_of(TagFamily family);

// Returns the default board of a family: the largest tags up to the default size that fit with
// their white margins into the default pitch. `size_m`, `pitch_m`: given values; a given size may
// need a larger pitch.
[[nodiscard]] Result<TagBoard> tag_board_of(TagFamily family, std::optional<double> size_m = {},
                                            std::optional<double> pitch_m = {});

// `printed_scale`: true / nominal length on the printed sheet; 0.992 if the 100 mm ruler measures
// 99.2 mm. Fails if tags (with their white margins) overlap or the family has no such ids.
[[nodiscard]] Result<TagMap> tag_map_of(const TagBoard& board, double printed_scale = 1.0);

// Fails for a scale below 0.5 or above 2, which is a wrong measurement.
[[nodiscard]] Result<void> check_printed_scale(double printed_scale);

// Size of the printed board [m], including the white margins of the outer tags.
struct BoardExtent {
  double width = 0.0;
  double height = 0.0;
};
[[nodiscard]] Result<BoardExtent> extent_of(const TagBoard& board);

}  // namespace penumbra
