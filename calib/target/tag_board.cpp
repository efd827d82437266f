#include "calib/target/tag_board.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "calib/target/target.hpp"
#include "core/propagate.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {

Result<void> check_printed_scale(double printed_scale) {
  if (printed_scale >= 0.5 && printed_scale <= 2.0) return {};
  return fail(
      "the sheet's scale is {}; measure the ruler again: 100 mm should come out at 50 to 200 mm",
      printed_scale);
}

Result<BoardExtent> extent_of(const TagBoard& board) {
  if (board.columns < 1 || board.rows < 1 || board.columns > 100 || board.rows > 100) {
    return fail("a board of {} columns and {} rows: give 1 to 100 of each", board.columns,
                board.rows);
  }
  if (!(board.tag_size_m >= 0.001 && board.tag_size_m <= 2.0)) {
    return fail("tag size {} m: give the edge of the black square, 0.001 to 2 m", board.tag_size_m);
  }
  PENUMBRA_TRY(const TagPattern pattern, TagPattern::make(board.family, board.first_id));
  const double printed = board.tag_size_m * pattern.total_width() / pattern.width_at_border();
  if (!(board.pitch_m >= printed * (1.0 - 1e-9)) || !std::isfinite(board.pitch_m)) {
    return fail("pitch {} m: tags of {} m need {:.4f} m each with their white margin",
                board.pitch_m, board.tag_size_m, printed);
  }
  return BoardExtent{board.pitch_m * (board.columns - 1) + printed,
                     board.pitch_m * (board.rows - 1) + printed};
}

double whole_mm_below(double length_m) {
  return 1e-3 * std::floor(1e3 * length_m + 1e-9);
}

Result<double> printed_ratio_of(TagFamily family) {
  PENUMBRA_TRY(const TagPattern pattern, TagPattern::make(family, 0));
  return static_cast<double>(pattern.total_width()) / pattern.width_at_border();
}

Result<TagBoard> tag_board_of(TagFamily family, std::optional<double> size_m,
                              std::optional<double> pitch_m) {
  PENUMBRA_TRY(const double ratio, printed_ratio_of(family));
  TagBoard board;
  board.family = family;
  board.tag_size_m =
      size_m.value_or(std::min(board.tag_size_m, whole_mm_below(board.pitch_m / ratio)));
  constexpr double kGap = 1.1;  // pitch over the width with margins, for a size that needs it
  const double printed_m = ratio * board.tag_size_m;
  if (printed_m > (1.0 + 1e-9) * board.pitch_m)
    board.pitch_m = 1e-3 * std::ceil(1e3 * kGap * printed_m);
  board.pitch_m = pitch_m.value_or(board.pitch_m);
  return board;
}

Result<TagMap> tag_map_of(const TagBoard& board, double printed_scale) {
  PENUMBRA_TRY_VOID(extent_of(board));
  PENUMBRA_TRY_VOID(check_printed_scale(printed_scale));
  std::vector<MappedTag> tags;
  for (int row = 0; row < board.rows; ++row) {
    for (int column = 0; column < board.columns; ++column) {
      const double x = (column - 0.5 * (board.columns - 1)) * board.pitch_m * printed_scale;
      const double y = (0.5 * (board.rows - 1) - row) * board.pitch_m * printed_scale;
      PENUMBRA_TRY(tags.emplace_back(),
                   flat_tag(board.family, board.first_id + row * board.columns + column,
                            board.tag_size_m * printed_scale, x, y));
    }
  }
  return TagMap::make(std::move(tags));
}

}  // namespace penumbra
