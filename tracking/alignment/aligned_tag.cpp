#include "tracking/alignment/aligned_tag.hpp"

#include <algorithm>
#include <cstddef>
#include <utility>

namespace penumbra {
namespace {

// Returns the coefficients of a vertex for two or three lines; see pattern() in residuals_body.hpp.
std::array<float, 16> coefficients_of(const TagPattern& pattern, int i, int j, int lines) {
  const auto colour = [&](int di, int dj) { return pattern.white(i + di, j + dj) ? 1.0F : 0.0F; };
  const int first = lines == 3 ? -1 : 0;  // first line from the vertex; cell first - 1 precedes it
  std::array<float, 16> c{};
  for (int row = 0; row < lines; ++row) {
    const int dj = first + row;
    for (int column = 0; column < lines; ++column) {
      const int di = first + column;
      c[static_cast<std::size_t>(4 * row + column)] =
          colour(di, dj) - colour(di - 1, dj) - colour(di, dj - 1) + colour(di - 1, dj - 1);
    }
    c[static_cast<std::size_t>(4 * row + 3)] = colour(first - 1, dj) - colour(first - 1, dj - 1);
  }
  for (int column = 0; column < lines; ++column)
    c[static_cast<std::size_t>(12 + column)] =
        colour(first + column, first - 1) - colour(first + column - 1, first - 1);
  c[15] = colour(first - 1, first - 1);
  return c;
}

void add_lattice(AlignedTag& tag) {
  for (int j = 0; j < tag.side; ++j) {
    for (int i = 0; i < tag.side; ++i) {
      tag.lattice_a.push_back(static_cast<float>(i));
      tag.lattice_b.push_back(static_cast<float>(j));
      const auto colour = [&](int di, int dj) {
        return tag.pattern.white(i + di, j + dj) ? 1.0F : 0.0F;
      };
      const float c0 = colour(-1, -1);
      const float c1 = colour(0, -1) - c0;
      const float c2 = colour(-1, 0) - c0;
      tag.coefficients1.push_back({c0, c1, c2, colour(0, 0) - c0 - c1 - c2});
      tag.coefficients2.push_back(coefficients_of(tag.pattern, i, j, 2));
      tag.coefficients3.push_back(coefficients_of(tag.pattern, i, j, 3));
    }
  }
  while (tag.lattice_a.size() % 16 != 0) {
    tag.lattice_a.push_back(tag.lattice_a.back());
    tag.lattice_b.push_back(tag.lattice_b.back());
  }
  const std::size_t vertices = tag.lattice_a.size();
  for (auto* array :
       {&tag.ray_x, &tag.ray_y, &tag.pixel_x, &tag.pixel_y, &tag.depth, &tag.ka, &tag.kb, &tag.rho})
    array->resize(vertices);
}

void add_runs(AlignedTag& tag) {
  for (const EdgeRun& run : tag.pattern.runs()) {
    const auto vertex = [&](int along) {
      return static_cast<std::uint32_t>(run.vertical ? along * tag.side + run.position
                                                     : run.position * tag.side + along);
    };
    for (int cell = run.begin; cell < run.end; ++cell) {
      std::vector<simd::Walk::Cell>& cells = tag.edge_cells[run.vertical ? 1 : 0];
      cells.push_back({static_cast<float>(cell - static_cast<int>(cells.size())),
                       static_cast<float>(run.position),
                       static_cast<std::int32_t>(tag.runs.size())});
    }
    tag.runs.push_back({vertex(run.begin), vertex(run.end), run.vertical});
  }
  for (std::vector<simd::Walk::Cell>& cells : tag.edge_cells) {
    if (!cells.empty()) cells.push_back(simd::Walk::Cell(cells.back()));
  }
}

// Selects equal numbers of white and black cells, spread over the tag.
void add_search_cells(AlignedTag& tag) {
  std::vector<DataCell> white;
  std::vector<DataCell> black;
  for (const DataCell& cell : tag.pattern.data_cells())
    (cell.white ? white : black).push_back(cell);
  const std::size_t pairs =
      std::min({white.size(), black.size(), static_cast<std::size_t>(kMaxSearchCells / 2)});
  tag.search_white = static_cast<int>(pairs);
  for (std::vector<DataCell>* cells : {&white, &black}) {
    for (std::size_t k = 0; k < pairs; ++k)
      tag.search_cells.push_back((*cells)[k * cells->size() / pairs]);
  }
  for (const DataCell& cell : tag.search_cells) {
    tag.search_a.push_back(static_cast<float>(cell.i) + 0.5F);
    tag.search_b.push_back(static_cast<float>(cell.j) + 0.5F);
  }
  const auto last = static_cast<float>(tag.side - 1);
  for (const auto& [a, b] : {std::pair(0.0F, 0.0F), std::pair(last, 0.0F), std::pair(0.0F, last),
                             std::pair(last, last)}) {
    tag.search_a.push_back(a);
    tag.search_b.push_back(b);
  }
  while (tag.search_a.size() % 16 != 0) {
    tag.search_a.push_back(last);
    tag.search_b.push_back(last);
  }
  for (auto* array : {&tag.search_x, &tag.search_y, &tag.search_depth})
    array->resize(tag.search_a.size());
}

}  // namespace

Result<AlignedTag> AlignedTag::make(const MappedTag& mapped) {
  Result<TagPattern> pattern = TagPattern::make(mapped.family, mapped.id);
  if (!pattern) return tl::unexpected<Error>(pattern.error());
  AlignedTag tag;
  tag.pattern = std::move(*pattern);
  tag.T_map_tag.linear() = mapped.T_table_tag.rotation_matrix();
  tag.T_map_tag.translation() = mapped.T_table_tag.translation();
  tag.cell_m = mapped.size_m / tag.pattern.width_at_border();
  if (const TagCurvature& c = mapped.curvature; !c.is_flat()) {
    tag.is_curved = true;
    const double centre = c.height(0.0, 0.0, mapped.size_m) / tag.cell_m;
    for (const auto& [k, value] :
         {std::pair(0U, centre), std::pair(1U, c.xx * tag.cell_m), std::pair(2U, c.xy * tag.cell_m),
          std::pair(3U, c.yy * tag.cell_m)})
      tag.height[k] = static_cast<float>(value);
  }
  tag.side = tag.pattern.total_width() + 1;
  add_lattice(tag);
  add_runs(tag);
  add_search_cells(tag);
  return tag;
}

}  // namespace penumbra
