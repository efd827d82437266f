#include "tracking/alignment/tag_pattern.hpp"

#include <algorithm>

#include "core/assert.hpp"
#include "tracking/detection/tag_families.hpp"

namespace penumbra {
namespace {

// `step_at(position, along)`: change of colour from cell position - 1 to position; 0: no edge.
template <class Step>
void append_runs(int width, bool vertical, const Step& step_at, std::vector<EdgeRun>& runs) {
  for (int position = 1; position < width; ++position) {
    int along = 0;
    while (along < width) {
      const int step = step_at(position, along);
      const int begin = along;
      do {
        ++along;
      } while (along < width && step_at(position, along) == step);
      if (step != 0) runs.push_back({vertical, position, begin, along, step});
    }
  }
}

}  // namespace

Result<TagPattern> TagPattern::make(TagFamily family, int id) {
  const TagFamilyHandle handle = make_tag_family(family);
  if (!handle) return fail("no memory for the tag family {}", to_string(family));
  if (id < 0 || static_cast<std::uint32_t>(id) >= handle->ncodes) {
    return fail("tag id {} does not exist in family {}; ids are 0 to {}", id, to_string(family),
                handle->ncodes - 1);
  }
  TagPattern pattern;
  pattern.width_at_border_ = handle->width_at_border;
  pattern.total_width_ = handle->total_width;
  const int width = pattern.total_width_;
  const auto side = static_cast<std::size_t>(width);
  pattern.cells_.assign(side * side, 0);
  const auto set_white = [&](int column, int row_from_top) {
    const int cell = (width - 1 - row_from_top) * width + column;
    PENUMBRA_ASSERT(cell >= 0 && cell < width * width);
    pattern.cells_[static_cast<std::size_t>(cell)] = 1;
  };

  // The white ring is outside a black border; a reversed border is itself white.
  const int ring_width = pattern.width_at_border_ + (handle->reversed_border ? 0 : 2);
  const int ring_start = (width - ring_width) / 2;
  const int ring_end = ring_start + ring_width - 1;
  for (int k = ring_start; k <= ring_end; ++k) {
    set_white(k, ring_start);
    set_white(k, ring_end);
    set_white(ring_start, k);
    set_white(ring_end, k);
  }
  // Bit coordinates start at the border's top left corner; negative coordinates are outside.
  const int border_start = (width - pattern.width_at_border_) / 2;
  const std::uint64_t code = handle->codes[static_cast<std::size_t>(id)];
  for (std::uint32_t k = 0; k < handle->nbits; ++k) {
    const int column = static_cast<std::int32_t>(handle->bit_x[k]) + border_start;
    const int row = static_cast<std::int32_t>(handle->bit_y[k]) + border_start;
    const bool white = ((code >> (handle->nbits - 1 - k)) & 1U) != 0;
    if (white) set_white(column, row);
    pattern.data_cells_.push_back({column, width - 1 - row, white});
  }

  // Cells outside the border and the ring around it are printed only if they are data cells.
  std::vector<std::uint8_t>& printed = pattern.printed_;
  printed.assign(pattern.cells_.size(), 0);
  const int printed_start = border_start - 1;
  const int printed_end = printed_start + pattern.width_at_border_ + 1;
  for (int j = std::max(printed_start, 0); j <= std::min(printed_end, width - 1); ++j) {
    for (int i = std::max(printed_start, 0); i <= std::min(printed_end, width - 1); ++i)
      printed[static_cast<std::size_t>(j * width + i)] = 1;
  }
  for (const DataCell& cell : pattern.data_cells_)
    printed[static_cast<std::size_t>(cell.j * width + cell.i)] = 1;
  const auto step = [&](int i0, int j0, int i1, int j1) {
    const auto from = static_cast<std::size_t>(j0 * width + i0);
    const auto to = static_cast<std::size_t>(j1 * width + i1);
    if (printed[from] == 0 || printed[to] == 0) return 0;
    return static_cast<int>(pattern.cells_[to]) - static_cast<int>(pattern.cells_[from]);
  };
  append_runs(
      width, true, [&](int p, int along) { return step(p - 1, along, p, along); }, pattern.runs_);
  append_runs(
      width, false, [&](int p, int along) { return step(along, p - 1, along, p); }, pattern.runs_);
  return pattern;
}

}  // namespace penumbra
