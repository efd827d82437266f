#include "tracking/alignment/search_window.hpp"

#include <cmath>
#include <cstddef>

namespace penumbra {
namespace {

// A cell's centre reads the same wherever in its cell it is, so that the top is as wide as a cell,
// and noise decides where on it the highest place is. What is higher than most of the peak counts
// alike, and its flanks by as much as they reach up: their middle is found between places and rows.
template <class Score>
SearchTop find_top(const SearchWindow& window, std::span<const Score> scores, int row, int column,
                   double cell) {
  // Of the peak: a pattern displaced against itself stays under the foot.
  constexpr int kParts = 5;
  constexpr int kFoot = 3;
  constexpr int kShoulder = 4;
  const int last_row = window.rows - 1;
  const int last_column = 2 * window.reach;
  const auto peak =
      static_cast<int>(scores[static_cast<std::size_t>(row * window.columns + column)]);
  if (peak <= 0) return {static_cast<double>(row), static_cast<double>(column), true};
  // Wherever on the top the highest place is, its other end is about a cell away.
  const int half = static_cast<int>(std::ceil(cell)) + 1;
  const int half_rows = (half + window.row_step - 1) / window.row_step;
  const int r0 = std::max(row - half_rows, 0);
  const int r1 = std::min(row + half_rows, last_row);
  const int c0 = std::max(column - half, 0);
  const int c1 = std::min(column + half, last_column);
  const int foot = kFoot * peak / kParts;
  const int shoulder = kShoulder * peak / kParts;
  double sum = 0.0;
  double sum_rows = 0.0;
  double sum_columns = 0.0;
  bool open = false;
  for (int r = r0; r <= r1; ++r) {
    const Score* const of_row = scores.data() + static_cast<std::ptrdiff_t>(r) * window.columns;
    int of_places = 0;
    int of_columns = 0;  // from c0
    int highest = 0;
    for (int c = c0; c <= c1; ++c) {
      const int value = of_row[c];
      const int up = std::clamp(value, foot, shoulder) - foot;
      of_places += up;
      of_columns += up * (c - c0);
      highest = std::max(highest, value);
    }
    open = open || ((r == 0 || r == last_row) && highest >= shoulder) ||
           (c0 == 0 && of_row[0] >= shoulder) ||
           (c1 == last_column && of_row[last_column] >= shoulder);
    sum += of_places;
    sum_rows += static_cast<double>(of_places) * r;
    sum_columns += static_cast<double>(of_columns) + static_cast<double>(of_places) * c0;
  }
  if (!(sum > 0.0)) return {static_cast<double>(row), static_cast<double>(column), open};
  return {sum_rows / sum, sum_columns / sum, open};
}

}  // namespace

SearchWindow SearchWindow::of_reach(int reach, int row_step) {
  SearchWindow window;
  window.reach = reach;
  window.columns = 2 * (reach + 1);
  window.row_step = row_step;
  window.rows = 2 * (reach / row_step) + 1;
  window.first_row = -(reach / row_step) * row_step;
  return window;
}

SearchTop SearchWindow::top_about(std::span<const std::int32_t> scores, int row, int column,
                                  double cell) const {
  return find_top(*this, scores, row, column, cell);
}
SearchTop SearchWindow::top_about(std::span<const std::int16_t> scores, int row, int column,
                                  double cell) const {
  return find_top(*this, scores, row, column, cell);
}

std::optional<OwnPeak> own_peak(const AlignedTag& tag, const SearchWindow& window, OwnPeak about,
                                int slack, double least_contrast) {
  const int columns = window.columns;
  const int last_row = window.rows - 1;
  const int last_column = 2 * window.reach;
  const int slack_rows = slack / window.row_step;
  const int r0 = std::max(about.row - slack_rows, 0);
  const int r1 = std::min(about.row + slack_rows, last_row);
  const int c0 = std::max(about.column - slack, 0);
  const int c1 = std::min(about.column + slack, last_column);
  const auto value = [&](int r, int c) {
    return tag.scores[static_cast<std::size_t>(r * columns + c)];
  };
  int score = -1;
  int at_row = 0;
  int at_column = 0;
  for (int r = r0; r <= r1; ++r) {
    for (int c = c0; c <= c1; ++c) {
      if (value(r, c) <= score) continue;
      score = value(r, c);
      at_row = r;
      at_column = c;
    }
  }
  if (2.0 * score / tag.score_points < least_contrast) return std::nullopt;
  if ((at_row == r0 && r0 > 0 && value(r0 - 1, at_column) > score) ||
      (at_row == r1 && r1 < last_row && value(r1 + 1, at_column) > score) ||
      (at_column == c0 && c0 > 0 && value(at_row, c0 - 1) > score) ||
      (at_column == c1 && c1 < last_column && value(at_row, c1 + 1) > score))
    return std::nullopt;
  return OwnPeak{at_row, at_column};
}

}  // namespace penumbra
