// Marching squares; each square lies between four cell centres of a field.
#include <algorithm>
#include <array>
#include <optional>

#include "core/vector_clones.hpp"
#include "render/shadow/casters/set_flags.hpp"
#include "render/shadow/fields/power_distance.hpp"

namespace penumbra {
namespace {

struct FieldCorner {
  int column, row;
  float value;
};

PlanePoint field_point(const ShadowField& field, double column, double row) {
  return {static_cast<float>(field.origin.x() + field.cell * (column + 0.5)),
          static_cast<float>(field.origin.y() + field.cell * (row + 0.5))};
}

// Interpolates from the side's lower end, so that both squares at a side get the same point.
PlanePoint field_crossing(const ShadowField& field, FieldCorner a, FieldCorner b) {
  if (b.row < a.row || (b.row == a.row && b.column < a.column)) std::swap(a, b);
  const double t =
      static_cast<double>(a.value) / (static_cast<double>(a.value) - static_cast<double>(b.value));
  return field_point(field, a.column + t * (b.column - a.column), a.row + t * (b.row - a.row));
}

// Returns the corners counter-clockwise.
std::array<FieldCorner, 4> corners_of(const ShadowField& field, const std::vector<float>& values,
                                      int column, int row) {
  const auto stride = static_cast<std::size_t>(field.width);
  const std::size_t i = static_cast<std::size_t>(row) * stride + static_cast<std::size_t>(column);
  return {FieldCorner{column, row, values[i]}, FieldCorner{column + 1, row, values[i + 1]},
          FieldCorner{column + 1, row + 1, values[i + stride + 1]},
          FieldCorner{column, row + 1, values[i + stride]}};
}

PENUMBRA_VECTOR_CLONES
void mark_inside(const float* __restrict values, std::size_t count,
                 std::uint8_t* __restrict inside) {
  for (std::size_t i = 0; i < count; ++i) inside[i] = values[i] > 0.0F ? 1 : 0;
}

// Sets crossed[i] = 1 if the corners of square i between two rows differ. Rows: count + 1 cells.
PENUMBRA_VECTOR_CLONES
void mark_crossed(const std::uint8_t* low, const std::uint8_t* high, std::size_t count,
                  std::uint8_t* __restrict crossed) {
  for (std::size_t i = 0; i < count; ++i) {
    crossed[i] = static_cast<std::uint8_t>((low[i] ^ low[i + 1]) | (low[i] ^ high[i]) |
                                           (low[i] ^ high[i + 1]));
  }
}

// Appends a layer's outline in one square. at_border[i]: side i is on the raster's border, where
// the outline follows the border.
void add_sides(const ShadowField& field, const std::array<FieldCorner, 4>& corners,
               const std::array<bool, 4>& at_border, std::vector<OutlineSide>& sides) {
  std::array<std::optional<PlanePoint>, 4> exits;    // per side: where the layer ends
  std::array<std::optional<PlanePoint>, 4> entries;  // per side: where the layer begins
  for (std::size_t c = 0; c < 4; ++c) {
    const FieldCorner& from = corners[c];
    const FieldCorner& to = corners[(c + 1) % 4];
    const bool from_inside = from.value > 0.0F;
    const bool to_inside = to.value > 0.0F;
    if (from_inside != to_inside)
      (from_inside ? exits : entries)[c] = field_crossing(field, from, to);
    if (!at_border[c] || (!from_inside && !to_inside)) continue;
    sides.push_back({from_inside ? field_point(field, from.column, from.row) : entries[c].value(),
                     to_inside ? field_point(field, to.column, to.row) : exits[c].value()});
  }
  // Connects each exit to the next entry.
  for (std::size_t c = 0; c < 4; ++c) {
    if (!exits[c]) continue;
    std::size_t entry = (c + 1) % 4;
    while (!entries[entry]) entry = (entry + 1) % 4;
    sides.push_back({*exits[c], *entries[entry]});
  }
}

}  // namespace

std::vector<PlanePoint> field_triangles(const ShadowField& field, ShadowLayer layer) {
  std::vector<PlanePoint> triangles;
  const std::vector<float>& values = field.layer(layer);
  for (int row = 0; row + 1 < field.height; ++row) {
    for (int column = 0; column + 1 < field.width; ++column) {
      const std::array<FieldCorner, 4> corners = corners_of(field, values, column, row);
      std::array<PlanePoint, 8> polygon;
      std::size_t count = 0;
      for (std::size_t c = 0; c < 4; ++c) {
        const FieldCorner& from = corners[c];
        const FieldCorner& to = corners[(c + 1) % 4];
        if (from.value > 0.0F) polygon[count++] = field_point(field, from.column, from.row);
        if ((from.value > 0.0F) != (to.value > 0.0F))
          polygon[count++] = field_crossing(field, from, to);
      }
      for (std::size_t c = 2; c < count; ++c)
        triangles.insert(triangles.end(), {polygon[0], polygon[c - 1], polygon[c]});
    }
  }
  return triangles;
}

std::vector<OutlineSide> field_outline(const ShadowField& field, ShadowLayer layer) {
  std::vector<OutlineSide> sides;
  const std::vector<float>& values = field.layer(layer);
  if (field.width < 2 || field.height < 2) return sides;
  const auto width = static_cast<std::size_t>(field.width);
  const std::size_t squares = width - 1;  // in a row
  std::vector<std::uint8_t> low(width);
  std::vector<std::uint8_t> high(width);
  std::vector<std::uint8_t> visited((squares + 7) / 8 * 8);
  mark_inside(values.data(), width, high.data());
  for (int row = 0; row + 1 < field.height; ++row) {
    std::swap(low, high);
    mark_inside(values.data() + static_cast<std::size_t>(row + 1) * width, width, high.data());
    mark_crossed(low.data(), high.data(), squares, visited.data());
    const bool first_row = row == 0;
    const bool last_row = row + 2 == field.height;
    if (first_row || last_row) std::fill_n(visited.begin(), squares, std::uint8_t{1});
    visited[0] = visited[squares - 1] = 1;
    for_each_set(visited, [&](std::size_t i) {
      add_sides(field, corners_of(field, values, static_cast<int>(i), row),
                {first_row, i + 1 == squares, last_row, i == 0}, sides);
    });
  }
  return sides;
}

}  // namespace penumbra
