#include "render/shadow/masks/silhouette_mask.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/assert.hpp"
#include "core/vector_clones.hpp"
#include "render/shadow/casters/set_flags.hpp"

namespace penumbra {
namespace {

constexpr std::int32_t kFullCell = 1 << 17;  // twice the area of a cell [squared subcells]
// kMaxSheets: number of sheets (overlapping faces over a cell) that a sum can hold.
// kClampedSheets: sums are clamped to this to make room; it is large enough to make the rounding of
// edges negligible.
constexpr std::size_t kMaxSheets = std::numeric_limits<std::int32_t>::max() / kFullCell;
constexpr std::size_t kClampedSheets = 512;
constexpr std::size_t kSheetsAtOnce = kMaxSheets - kClampedSheets;

// Computes the factor on the encoded value of cells that layers cover partially.
PENUMBRA_VECTOR_CLONES
void mask_values_of(const std::int32_t* umbra, const std::int32_t* middle,
                    const std::int32_t* penumbra, std::size_t count, float umbra_light,
                    float middle_light, float penumbra_light, std::uint8_t* __restrict codes) {
  for (std::size_t i = 0; i < count; ++i) {
    const auto coverage = [](std::int32_t covered) {
      const std::int32_t area = covered < 0 ? -covered : covered;
      return static_cast<float>(area < kFullCell ? area : kFullCell) * (1.0F / kFullCell);
    };
    // A layer lies within the next lighter one, and their edges coincide at contact with the plane.
    // The covered areas therefore overlap as far as possible.
    const float dark = coverage(umbra[i]);
    const float half = std::max(dark, coverage(middle[i]));
    const float any = std::max(half, coverage(penumbra[i]));
    const float sum = 1.0F + any * (penumbra_light - 1.0F) +
                      half * (middle_light - penumbra_light) + dark * (umbra_light - middle_light);
    codes[i] = static_cast<std::uint8_t>(static_cast<std::int32_t>(255.0F * sum + 0.5F));
  }
}

// Returns value / by, rounded down; by > 0. Most values fit into 32 bits, whose division is faster
// on many processors.
std::int64_t quotient(std::int64_t value, std::int64_t by) {
  const auto narrow = static_cast<std::int32_t>(value);
  if (narrow == value) {
    const auto divisor = static_cast<std::int32_t>(by);
    return narrow / divisor - (narrow % divisor < 0 ? 1 : 0);
  }
  return value / by - (value % by < 0 ? 1 : 0);
}

// Sums of one layer in one row of the mask.
struct RowSums {
  std::array<std::int32_t, 4>* steps;
  std::uint8_t* touched;
  std::size_t layer;
  int sign;

  void move(std::ptrdiff_t cells) {
    steps += cells;
    touched += cells;
  }
  // Adds the part of an edge that lies in one cell. `twice_u`: twice its mean u in the cell.
  void add(std::int64_t cell, std::int64_t rise, std::int64_t twice_u) const {
    const auto area = static_cast<std::int32_t>(rise * twice_u);
    const auto whole = static_cast<std::int32_t>(2 * MaskCaster::kSubcells * rise);
    steps[cell][layer] += sign * (whole - area);
    steps[cell + 1][layer] += sign * area;
    touched[cell] = touched[cell + 1] = 1;
  }
};

// Adds the part of an edge that lies in one row, from `u0` to `u1`, and crosses cells or lies
// partly beside the mask.
void add_across_cells(const RowSums& sums, std::int64_t width, std::int64_t u0, std::int64_t u1,
                      std::int64_t rise) {
  const std::int64_t first = u0 >> MaskCaster::kSubcellBits;
  const std::int64_t last = u1 >> MaskCaster::kSubcellBits;
  const bool right = last >= first;
  const std::int64_t run = right ? u1 - u0 : u0 - u1;
  // Returns the part of `rise` before a column's border.
  const auto rise_at = [=](std::int64_t u) {
    return quotient(rise * (right ? u - u0 : u0 - u), run);
  };
  const int step = right ? 1 : -1;
  const int border = right ? MaskCaster::kSubcells : 0;
  if (std::min(first, last) >= 0 && std::max(first, last) < width) {  // most edges
    std::int64_t border_u = MaskCaster::kSubcells * first + border;
    std::int64_t before = rise_at(border_u);
    sums.add(first, before, u0 - MaskCaster::kSubcells * first + border);
    for (std::int64_t inner = first + step; inner != last; inner += step) {
      border_u += step * MaskCaster::kSubcells;
      const std::int64_t next = rise_at(border_u);
      sums.add(inner, next - before, MaskCaster::kSubcells);
      before = next;
    }
    sums.add(last, rise - before,
             MaskCaster::kSubcells - border + u1 - MaskCaster::kSubcells * last);
    return;
  }
  // The part of an edge left of the mask covers its rows from the first cell on; the part right of
  // the mask has no effect.
  std::int64_t done = 0;
  std::int64_t cell = first;
  if (right && first < 0) {
    done = last < 0 ? rise : rise_at(0);
    sums.add(0, done, 0);
    cell = 0;
  } else if (!right && first >= width) {
    if (last >= width) return;
    cell = width - 1;
    done = rise_at(MaskCaster::kSubcells * width);
  }
  const std::int64_t stop = right ? std::min(last, width - 1) : std::max<std::int64_t>(last, 0);
  for (; right ? cell <= stop : cell >= stop; cell += step) {
    const std::int64_t corner = MaskCaster::kSubcells * cell;
    const std::int64_t next = cell == last ? rise : rise_at(corner + border);
    sums.add(cell, next - done,
             (cell == first ? u0 - corner : MaskCaster::kSubcells - border) +
                 (cell == last ? u1 - corner : border));
    done = next;
  }
  if (!right && last < 0) sums.add(0, rise - done, 0);
}

}  // namespace

void MaskRaster::begin(const MaskCells& cells) {
  cells_ = cells;
  sheets_ = {};
  row_cells_ = (static_cast<std::size_t>(cells.width) + 8) / 8 * 8;
  // finish() and take() leave all steps 0.
  const std::size_t needed = row_cells_ * static_cast<std::size_t>(cells.height);
  if (steps_.size() >= needed) return;
  steps_.resize(needed);
  touched_.resize(needed);
}

void MaskRaster::cover(MaskCaster& caster, std::span<const std::uint32_t> indices,
                       std::span<const SharedEdge> edges) {
  const CellBox mask_box(Position(cells_.u, cells_.v),
                         Position(cells_.u + cells_.width - 1, cells_.v + cells_.height - 1));
  // Outside the mask, the edges of a closed outline cancel.
  if (!mask_box.intersects(caster.bounds_)) return;
  const std::vector<MaskCaster::Images>& images = caster.images_;
  std::vector<std::uint8_t>& ccw = caster.counter_clockwise_;
  ccw.resize(indices.size() / 3);
  const auto wanted = static_cast<std::uint8_t>(
      (caster.wanted_[0] ? 1 : 0) | (caster.wanted_[1] ? 2 : 0) | (caster.wanted_[2] ? 4 : 0));
  for (std::size_t face = 0; face < ccw.size(); ++face) {
    const MaskCaster::Images& a = images[indices[3 * face]];
    const MaskCaster::Images& b = images[indices[3 * face + 1]];
    const MaskCaster::Images& c = images[indices[3 * face + 2]];
    // The sign of a tiny area is arbitrary but the same for all edges of a face.
    std::array<float, 4> area;
    for (std::size_t layer = 0; layer < 4; ++layer) {
      area[layer] = (b.u[layer] - a.u[layer]) * (c.v[layer] - a.v[layer]) -
                    (c.u[layer] - a.u[layer]) * (b.v[layer] - a.v[layer]);
    }
    const unsigned bits =
        (area[0] > 0.0F ? 1U : 0U) | (area[1] > 0.0F ? 2U : 0U) | (area[2] > 0.0F ? 4U : 0U);
    ccw[face] = static_cast<std::uint8_t>(bits & wanted);
  }
  // At any point, half of the faces are counter-clockwise, and half of the outline edges go up.
  std::size_t sheets = (ccw.size() + 1) / 2;
  if (sheets > kSheetsAtOnce) {
    const auto outlines = std::ranges::count_if(
        edges, [&ccw](const SharedEdge& edge) { return ccw[edge.forward] != ccw[edge.back]; });
    sheets = std::min(sheets, (static_cast<std::size_t>(outlines) + 1) / 2);
  }
  const Position first = MaskCaster::kSubcells * (caster.first_ - Position(cells_.u, cells_.v));
  if (sheets > kSheetsAtOnce) {
    cover_counter_clockwise(caster, indices, first);
  } else {
    for (std::size_t layer = 0; layer < 3; ++layer) {
      if (caster.wanted_[layer]) make_room(layer, sheets);
    }
    cover_outlines(caster, edges, first);
  }
  for (std::size_t layer = 0; layer < 3; ++layer) {
    cover_faces(caster.faces_[layer], layer, first);
    cover_lines(caster.sides_[layer], layer, first);
  }
}

void MaskRaster::cover_outlines(const MaskCaster& caster, std::span<const SharedEdge> edges,
                                const Position& first) {
  for (const SharedEdge& edge : edges) {
    const unsigned differ =
        caster.counter_clockwise_[edge.forward] ^ caster.counter_clockwise_[edge.back];
    if (differ == 0) continue;
    const MaskCaster::Images& from = caster.images_[edge.from];
    const MaskCaster::Images& to = caster.images_[edge.to];
    for (std::size_t layer = 0; layer < 3; ++layer) {
      if ((differ >> layer & 1U) == 0) continue;
      // Uses the edge's direction in the counter-clockwise face.
      const bool forward = (caster.counter_clockwise_[edge.forward] >> layer & 1U) != 0;
      add_edge(steps_, layer, first + (forward ? from : to).layer_position(layer),
               first + (forward ? to : from).layer_position(layer));
    }
  }
}

// Covers counter-clockwise faces one by one, because edges of outlines can't be split into batches
// that the sums can hold.
void MaskRaster::cover_counter_clockwise(const MaskCaster& caster,
                                         std::span<const std::uint32_t> indices,
                                         const Position& first) {
  for (std::size_t layer = 0; layer < 3; ++layer) {
    for (std::size_t face = 0; face < caster.counter_clockwise_.size(); ++face) {
      if ((caster.counter_clockwise_[face] >> layer & 1U) == 0) continue;
      std::array<Position, 3> corners;
      for (std::size_t corner = 0; corner < 3; ++corner)
        corners[corner] = first + caster.images_[indices[3 * face + corner]].layer_position(layer);
      make_room(layer, 1);
      add_face(steps_, layer, corners);
    }
  }
}

void MaskRaster::cover_faces(std::span<const Position> points, std::size_t layer,
                             const Position& first) {
  std::size_t room_for = 0;
  for (std::size_t i = 0; i + 2 < points.size(); i += 3) {
    if (i == room_for) {
      const std::size_t sheets = std::min(kSheetsAtOnce, (points.size() - i) / 3);
      make_room(layer, sheets);
      room_for += 3 * sheets;
    }
    std::array<Position, 3> p = {first + points[i], first + points[i + 1], first + points[i + 2]};
    const Position b = p[1] - p[0];
    const Position c = p[2] - p[0];
    const std::int64_t area = b.x() * c.y() - c.x() * b.y();
    if (area == 0) continue;
    if (area < 0) {
      if (back_.size() < steps_.size()) back_.resize(steps_.size());
      has_back_ = true;
      std::swap(p[1], p[2]);
    }
    add_face(area < 0 ? back_ : steps_, layer, p);
  }
}

// Traverses an edge in the same direction for both of its faces, so that it is rounded equally.
void MaskRaster::add_face(Steps& to, std::size_t layer, const std::array<Position, 3>& corners) {
  for (std::size_t corner = 0; corner < 3; ++corner) {
    const Position& a = corners[corner];
    const Position& b = corners[(corner + 1) % 3];
    if (std::pair(a.y(), a.x()) < std::pair(b.y(), b.x())) {
      add_edge(to, layer, a, b);
    } else {
      add_edge(to, layer, b, a, -1);
    }
  }
}

// Covers closed lines, which add one sheet: none lies inside another of the same orientation.
void MaskRaster::cover_lines(std::span<const Position> points, std::size_t layer,
                             const Position& first) {
  if (points.empty()) return;
  make_room(layer, 1);
  for (std::size_t i = 0; i + 1 < points.size(); i += 2)
    add_edge(steps_, layer, first + points[i], first + points[i + 1]);
}

void MaskRaster::make_room(std::size_t layer, std::size_t sheets) {
  if (sheets_[layer] + sheets > kMaxSheets) clamp_sums();
  sheets_[layer] += sheets;
  PENUMBRA_ASSERT(sheets_[layer] <= kMaxSheets);
}

// Clamps sums to kClampedSheets; covered cells stay covered.
void MaskRaster::clamp_sums() {
  static constexpr auto kMaxSum = static_cast<std::int32_t>(kClampedSheets) * kFullCell;
  const auto clamp_row = [](std::array<std::int32_t, 4>* steps,
                            std::span<const std::uint8_t> touched) {
    std::array<std::int32_t, 3> sum{};
    std::array<std::int32_t, 3> before{};
    for_each_set(touched, [&](std::size_t i) {
      for (std::size_t layer = 0; layer < 3; ++layer) {
        sum[layer] += steps[i][layer];
        const std::int32_t clamped = std::clamp(sum[layer], -kMaxSum, kMaxSum);
        steps[i][layer] = clamped - before[layer];
        before[layer] = clamped;
      }
    });
  };
  for (std::size_t row = 0; row < static_cast<std::size_t>(cells_.height); ++row) {
    const std::size_t begin = row * row_cells_;
    const auto touched = std::span(touched_).subspan(begin, row_cells_);
    clamp_row(&steps_[begin], touched);
    if (has_back_) clamp_row(&back_[begin], touched);
  }
  for (std::size_t& clamped : sheets_) clamped = std::min(clamped, kClampedSheets);
}

void MaskRaster::cover(const MaskCover& cover) {
  const auto u = static_cast<int>(cover.u_ - cells_.u);
  const auto v = static_cast<int>(cover.v_ - cells_.v);
  for (std::size_t layer = 0; layer < 3; ++layer) make_room(layer, cover.sheets_[layer]);
  if (!cover.back_.empty()) {
    if (back_.size() < steps_.size()) back_.resize(steps_.size());
    has_back_ = true;
  }
  for (std::size_t i = 0; i < cover.steps_.size(); ++i) {
    const MaskCover::Step& step = cover.steps_[i];
    PENUMBRA_ASSERT(u + step.u >= 0 && v + step.v >= 0 && v + step.v < cells_.height);
    const std::size_t at =
        static_cast<std::size_t>(v + step.v) * row_cells_ + static_cast<std::size_t>(u + step.u);
    for (std::size_t layer = 0; layer < 4; ++layer) steps_[at][layer] += step.front[layer];
    touched_[at] = 1;
    if (cover.back_.empty()) continue;
    for (std::size_t layer = 0; layer < 4; ++layer) back_[at][layer] += cover.back_[i][layer];
  }
}

void MaskRaster::take(MaskCover& cover) {
  cover.u_ = cells_.u;
  cover.v_ = cells_.v;
  cover.steps_.clear();
  cover.back_.clear();
  // Other masks need room for the sheets of this cover.
  if (std::ranges::max(sheets_) > kSheetsAtOnce) clamp_sums();
  cover.sheets_ = sheets_;
  for (int v = 0; v < cells_.height; ++v) {
    const std::size_t row = static_cast<std::size_t>(v) * row_cells_;
    const auto touched = std::span(touched_).subspan(row, row_cells_);
    for_each_set(touched, [&](std::size_t u) {
      cover.steps_.push_back({static_cast<int>(u), v, std::exchange(steps_[row + u], {})});
      if (has_back_) cover.back_.push_back(std::exchange(back_[row + u], {}));
    });
    std::ranges::fill(touched, std::uint8_t{0});
  }
  has_back_ = false;
}

// Splits the edge at the borders of the mask's rows.
void MaskRaster::add_edge(Steps& sums, std::size_t layer, const Position& from, const Position& to,
                          int sign) {
  const std::int64_t right = std::int64_t{MaskCaster::kSubcells} * cells_.width;
  const std::int64_t bottom = std::int64_t{MaskCaster::kSubcells} * cells_.height;
  const std::int64_t u0 = from.x();
  const std::int64_t v0 = from.y();
  const std::int64_t u1 = to.x();
  const std::int64_t v1 = to.y();
  if (v0 == v1 || std::max(v0, v1) <= 0 || std::min(v0, v1) >= bottom) return;
  if (std::min(u0, u1) >= right) return;
  const bool down = v1 > v0;
  const int step = down ? 1 : -1;
  const std::int64_t rise = step * (v1 - v0);
  const auto row_of = [this](std::int64_t v) {
    return std::clamp<std::int64_t>(v >> MaskCaster::kSubcellBits, 0, cells_.height - 1);
  };
  const std::int64_t last = row_of(down ? v1 - 1 : v1);
  std::int64_t row = row_of(down ? v0 : v0 - 1);
  // `border`: rise from `from` to the row's far border. `before`, `begin`: rise and u of its entry.
  std::int64_t border = step * (MaskCaster::kSubcells * (down ? row : row + 1) - v0);
  std::int64_t before = std::max<std::int64_t>(border, 0);
  const auto u_at = [&](std::int64_t height) { return u0 + quotient((u1 - u0) * height, rise); };
  std::int64_t begin = before == 0 ? u0 : u_at(before);
  RowSums row_sums{sums.data(), touched_.data(), layer, sign};
  row_sums.move(row * static_cast<std::ptrdiff_t>(row_cells_));
  const std::ptrdiff_t stride = step * static_cast<std::ptrdiff_t>(row_cells_);
  while (true) {
    border += MaskCaster::kSubcells;
    const std::int64_t after = std::min(border, rise);
    const std::int64_t end = after == rise ? u1 : u_at(after);
    const std::int64_t cell = begin >> MaskCaster::kSubcellBits;
    const std::int64_t height = step * (after - before);
    if (cell == end >> MaskCaster::kSubcellBits && cell >= 0 && cell < cells_.width) {
      row_sums.add(cell, height, begin + end - 2 * MaskCaster::kSubcells * cell);
    } else {
      add_across_cells(row_sums, cells_.width, begin, end, height);
    }
    if (row == last) return;
    row += step;
    row_sums.move(stride);
    begin = end;
    before = after;
  }
}

void MaskRaster::finish(const glm::vec3& light, std::vector<std::uint8_t>& codes) {
  codes.resize(static_cast<std::size_t>(cells_.width) * static_cast<std::size_t>(cells_.height));
  finish(light, std::span<std::uint8_t>(codes));
}

void MaskRaster::finish(const glm::vec3& light, std::span<std::uint8_t> codes) {
  const auto width = static_cast<std::size_t>(cells_.width);
  const auto height = static_cast<std::size_t>(cells_.height);
  PENUMBRA_ASSERT(codes.size() == width * height);
  std::ranges::fill(codes, std::uint8_t{255});
  changed_codes_.resize(row_cells_);
  for (std::size_t row = 0; row < height; ++row) {
    const std::size_t count = finish_row(row);
    mask_values_of(covered_[0].data(), covered_[1].data(), covered_[2].data(), count, light.x,
                   light.y, light.z, changed_codes_.data());
    std::uint8_t* const out = codes.data() + row * width;
    const std::uint8_t* const changed_codes = changed_codes_.data();
    std::ptrdiff_t end = begin_of(0, count);
    for (std::size_t i = 0; i < count; ++i) {
      const std::ptrdiff_t begin = std::exchange(end, begin_of(i + 1, count));
      const std::uint8_t code = changed_codes[i];
      if (code == 255 || begin == end) continue;
      out[begin] = code;
      if (end != begin + 1) std::fill(out + begin + 1, out + end, code);  // rarely
    }
  }
  has_back_ = false;
}

void MaskRaster::finish_coverage(const MaskCells& part, std::span<std::uint8_t> rgba) {
  PENUMBRA_ASSERT(part.size == cells_.size &&
                  rgba.size() == std::size_t{4} * static_cast<std::size_t>(part.width) *
                                     static_cast<std::size_t>(part.height));
  std::ranges::fill(rgba, std::uint8_t{0});
  const auto code = [](std::int32_t covered) {
    const std::int32_t area = std::min(covered < 0 ? -covered : covered, kFullCell);
    return static_cast<std::uint8_t>((std::int64_t{255} * area + kFullCell / 2) / kFullCell);
  };
  for (int row = 0; row < cells_.height; ++row) {
    const std::size_t count = finish_row(static_cast<std::size_t>(row));
    const std::int64_t part_row = cells_.v + row - part.v;
    if (part_row < 0 || part_row >= part.height) continue;
    std::uint8_t* out = rgba.data() + 4 * part_row * part.width;
    for (std::size_t i = 0; i < count; ++i) {
      const std::uint8_t umbra = code(covered_[0][i]);
      const std::uint8_t middle = std::max(umbra, code(covered_[1][i]));
      const std::uint8_t penumbra = std::max(middle, code(covered_[2][i]));
      if (penumbra == 0) continue;
      const auto column_of = [&](std::ptrdiff_t cell) {
        return std::clamp<std::int64_t>(cells_.u + cell - part.u, 0, part.width);
      };
      const std::int64_t end = column_of(begin_of(i + 1, count));
      for (std::int64_t cell = column_of(begin_of(i, count)); cell < end; ++cell) {
        out[4 * cell] = umbra;
        out[4 * cell + 1] = middle;
        out[4 * cell + 2] = penumbra;
      }
    }
  }
  has_back_ = false;
}

std::ptrdiff_t MaskRaster::begin_of(std::size_t i, std::size_t count) const {
  return i == count ? cells_.width : std::min<std::ptrdiff_t>(changed_[i], cells_.width);
}

std::size_t MaskRaster::finish_row(std::size_t row) {
  changed_.resize(row_cells_);
  for (std::vector<std::int32_t>& covered : covered_) covered.resize(row_cells_);
  const std::size_t begin = row * row_cells_;
  const std::span<std::uint8_t> touched = std::span(touched_).subspan(begin, row_cells_);
  std::array<std::int32_t, 4>* const steps = steps_.data() + begin;
  std::array<std::int32_t, 4>* const back = has_back_ ? back_.data() + begin : nullptr;
  const std::array covered = {covered_[0].data(), covered_[1].data(), covered_[2].data()};
  std::uint32_t* const changed = changed_.data();
  std::array<std::int32_t, 3> front{};
  std::array<std::int32_t, 3> behind{};
  std::size_t count = 0;
  for_each_set(touched, [&](std::size_t i) {
    for (std::size_t layer = 0; layer < 3; ++layer) {
      std::int32_t area = front[layer] += steps[i][layer];
      if (back != nullptr) {
        behind[layer] += back[i][layer];
        if (std::abs(behind[layer]) > std::abs(area)) area = behind[layer];
      }
      covered[layer][count] = area;
    }
    steps[i] = {};
    if (back != nullptr) back[i] = {};
    changed[count++] = static_cast<std::uint32_t>(i);
  });
  std::ranges::fill(touched, std::uint8_t{0});
  return count;
}

}  // namespace penumbra
