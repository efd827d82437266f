#include "render/shadow/fields/power_distance.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/vector_clones.hpp"
#include "render/shadow/casters/set_flags.hpp"
#include "render/shadow/fields/part_projection.hpp"
#include "render/shadow/fields/power_transform.hpp"

namespace penumbra {

namespace {

constexpr int kSpanBlock = 8;  // cells covered at a time
constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kUnclipped = std::numeric_limits<float>::max();  // level: clips nothing
// A cell represents a square, so its disc is half a cell larger.
constexpr float kHalfCell = 0.5F;
// A rectangle of cells of the field.
struct Window {
  int left = 0, bottom = 0, width = 0, height = 0;
};

// Sets flags[x] = 1 if a cell's value is above the level and the value of one of its eight
// neighbours is not; for x in [1, width - 1).
PENUMBRA_VECTOR_CLONES
void flag_outline(const float* above, const float* here, const float* below, std::size_t width,
                  float level, float* __restrict column_min, std::uint8_t* __restrict flags) {
  for (std::size_t x = 0; x < width; ++x) {
    const float minimum = above[x] < below[x] ? above[x] : below[x];
    column_min[x] = minimum < here[x] ? minimum : here[x];
  }
  for (std::size_t x = 1; x + 1 < width; ++x) {
    const float beside =
        column_min[x - 1] < column_min[x + 1] ? column_min[x - 1] : column_min[x + 1];
    const float minimum = beside < column_min[x] ? beside : column_min[x];
    const bool outline = (minimum <= level) & (here[x] > level);
    flags[x] = outline ? 1 : 0;
  }
}

// Sets flags[x] = 1 if a covered cell's disc may extend beyond those of its four neighbours
// (docs/shadows.md#fields). Rows hold the maximum rho, or -1 for uncovered cells.
PENUMBRA_VECTOR_CLONES
void flag_protruding_discs(const float* above, const float* here, const float* below,
                           std::size_t width, std::uint8_t* __restrict flags) {
  for (std::size_t x = 1; x + 1 < width; ++x) {
    const float upright = above[x] < below[x] ? above[x] : below[x];
    const float level = here[x - 1] < here[x + 1] ? here[x - 1] : here[x + 1];
    const float min_neighbour = upright < level ? upright : level;
    const float radius = here[x] + kHalfCell;
    const float beside = min_neighbour + kHalfCell;
    const bool protrudes = (min_neighbour < 0.0F) |
                           (radius * radius - beside * beside > 1.4142F * (radius - 1.5F) - 1.0F);
    flags[x] = ((here[x] >= 0.0F) & protrudes) ? 1 : 0;
  }
}

PENUMBRA_VECTOR_CLONES
void merge_penumbra(const float* __restrict distance, float* __restrict to, std::size_t count) {
  for (std::size_t x = 0; x < count; ++x) to[x] = to[x] > -distance[x] ? to[x] : -distance[x];
}

PENUMBRA_VECTOR_CLONES
void merge_cell_discs(const float* __restrict max_rho, float* __restrict to, std::size_t count) {
  for (std::size_t x = 0; x < count; ++x) {
    const float radius = max_rho[x] + kHalfCell;
    const float power = max_rho[x] >= 0.0F ? radius * radius : to[x];
    to[x] = to[x] > power ? to[x] : power;
  }
}

// Merges the distance into cells covered up to the level, its negative magnitude into other cells.
PENUMBRA_VECTOR_CLONES
void merge_umbra(const float* __restrict distance, const float* __restrict min_rho, float level,
                 float* __restrict to, std::size_t count) {
  for (std::size_t x = 0; x < count; ++x) {
    const float outside = distance[x] < 0.0F ? distance[x] : -distance[x];
    const float value = min_rho[x] <= level ? distance[x] : outside;
    to[x] = to[x] > value ? to[x] : value;
  }
}

PENUMBRA_VECTOR_CLONES
void merge_larger(const float* __restrict from, float* __restrict to, std::size_t count) {
  for (std::size_t x = 0; x < count; ++x) to[x] = to[x] > from[x] ? to[x] : from[x];
}

void sort_by_y(FieldPoint& a, FieldPoint& b, FieldPoint& c) {
  if (b.y < a.y) std::swap(a, b);
  if (c.y < b.y) std::swap(b, c);
  if (b.y < a.y) std::swap(a, b);
}

// The intersection of a triangle with a line of cell centres, y = line + 0.5: x from `from` to
// `to`, with the centres of the cells [first, end), counted from the window's edge.
struct FieldSpan {
  int line, first, end;
  float from, to;
};

// Calls use(span) for each inner line of a window that crosses the triangle. Returns false if none
// does. Corners are more than a cell inside the window, so truncation rounds down.
template <class Use>
[[gnu::always_inline]] inline bool for_each_span(FieldPoint a, FieldPoint b, FieldPoint c,
                                                 const Window& window, const Use& use) {
  sort_by_y(a, b, c);
  const auto bottom = static_cast<float>(window.bottom);
  const auto left = static_cast<float>(window.left);
  const int first_line = std::max(1, static_cast<int>(a.y - bottom + 0.5F));
  const int end_line = std::min(window.height - 1, static_cast<int>(c.y - bottom + 0.5F));
  if (first_line >= end_line) return false;
  const auto slope = [](const FieldPoint& from, const FieldPoint& to) {
    const float rise = to.y - from.y;
    return rise > 0.0F ? (to.x - from.x) / rise : 0.0F;
  };
  const float slope_ac = slope(a, c);
  const float slope_ab = slope(a, b);
  const float slope_bc = slope(b, c);
  for (int line = first_line; line < end_line; ++line) {
    const float y = static_cast<float>(line) + 0.5F + bottom;
    const float x_on_ac = a.x + (y - a.y) * slope_ac;
    const float x_on_abc = y < b.y ? a.x + (y - a.y) * slope_ab : b.x + (y - b.y) * slope_bc;
    const float from = std::min(x_on_ac, x_on_abc) - left;
    const float to = std::max(x_on_ac, x_on_abc) - left;
    use(FieldSpan{line, std::max(1, static_cast<int>(from + 0.5F)),
                  std::min(window.width - 1, static_cast<int>(to + 0.5F)), from, to});
  }
  return true;
}

// rho along a row: at_zero + slope * column, clamped to [low, high].
struct RowRho {
  float at_zero, slope, low, high;
};

// Covers a span's cells, in blocks that may extend beyond it and leave the cells there unchanged.
[[gnu::always_inline]] inline void cover_span(const RowRho& rho, int column, int count,
                                              float* __restrict max_rho,
                                              float* __restrict min_rho) {
  for (int first = 0; first < count; first += kSpanBlock) {
    for (int k = 0; k < kSpanBlock; ++k) {
      const int cell = first + k;
      float here = rho.at_zero + rho.slope * static_cast<float>(column + cell);
      here = here > rho.low ? here : rho.low;
      here = here < rho.high ? here : rho.high;
      const float above = here > max_rho[cell] ? here : max_rho[cell];
      const float below = here < min_rho[cell] ? here : min_rho[cell];
      max_rho[cell] = cell < count ? above : max_rho[cell];
      min_rho[cell] = cell < count ? below : min_rho[cell];
    }
  }
}

// Covers the cells of faces, three corners each, with their largest and smallest rho.
PENUMBRA_VECTOR_CLONES
void cover_faces(const FieldPoint* points, const std::uint32_t* corners, std::size_t count,
                 const Window& window, float* __restrict max_rho, float* __restrict min_rho) {
  const auto bottom = static_cast<float>(window.bottom);
  for (std::size_t i = 0; i + 2 < count; i += 3) {
    FieldPoint a = points[corners[i]];
    FieldPoint b = points[corners[i + 1]];
    FieldPoint c = points[corners[i + 2]];
    sort_by_y(a, b, c);
    const float area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if (area == 0.0F) continue;
    // rho is linear over a projected face.
    const float slope_x = ((b.rho - a.rho) * (c.y - a.y) - (c.rho - a.rho) * (b.y - a.y)) / area;
    const float slope_y = ((c.rho - a.rho) * (b.x - a.x) - (b.rho - a.rho) * (c.x - a.x)) / area;
    RowRho rho;
    rho.slope = slope_x;
    rho.low = std::min(a.rho, std::min(b.rho, c.rho));
    rho.high = std::max(a.rho, std::max(b.rho, c.rho));
    const float to_first = static_cast<float>(window.left) + 0.5F - a.x;
    for_each_span(a, b, c, window, [&](const FieldSpan& span) {
      const float y = static_cast<float>(span.line) + 0.5F + bottom;
      rho.at_zero = a.rho + slope_y * (y - a.y) + slope_x * to_first;
      const std::ptrdiff_t cell =
          static_cast<std::ptrdiff_t>(span.line) * window.width + span.first;
      cover_span(rho, span.first, span.end - span.first, max_rho + cell, min_rho + cell);
    });
  }
}

// Rasterises one part. One object serves many parts and reuses its memory.
class PartField {
 public:
  // Covers cells with the faces. `points`: [field cells]; the window has a margin of two cells.
  void cover(std::span<const FieldPoint> points, std::span<const std::uint32_t> corners,
             const Window& window) {
    window_ = window;
    const std::size_t count =
        static_cast<std::size_t>(window.width) * static_cast<std::size_t>(window.height);
    max_rho_.assign(count + kSpanBlock, -1.0F);
    min_rho_.assign(count + kSpanBlock, kInfinity);
    column_min_.resize(static_cast<std::size_t>(window.width));
    // Padded to a multiple of eight; the window's border is never flagged.
    flags_.assign((static_cast<std::size_t>(window.width) + 7) / 8 * 8, 0);
    cover_faces(points.data(), corners.data(), corners.size(), window, max_rho_.data(),
                min_rho_.data());
  }

  // Measures the distances from the cell centres of the unclipped outline to the part. `points` and
  // `corners` are those of cover().
  void find_gaps(std::span<const FieldPoint> points, std::span<const std::uint32_t> corners) {
    gaps_.start(min_rho_.size());
    if (!mark_tiles([](std::uint32_t) { return true; })) return;
    for (std::size_t i = 0; i + 2 < corners.size(); i += 3) {
      const std::array<FieldPoint, 3> face = {points[corners[i]], points[corners[i + 1]],
                                              points[corners[i + 2]]};
      if (touches_marked_tile(face)) lower_gaps(face[0], face[1], face[2], gaps_);
    }
  }

  // `disc_window`: bounds of all discs [cells].
  void add_penumbra(const Window& disc_window, ShadowField& field) {
    transform_.start(disc_window.width, disc_window.height);
    const int left = window_.left - disc_window.left;
    const int bottom = window_.bottom - disc_window.bottom;
    for (int row = 1; row + 1 < window_.height; ++row) {
      const float* here = max_rho_.data() + index_of(0, row);
      flag_protruding_discs(here + window_.width, here, here - window_.width,
                            static_cast<std::size_t>(window_.width), flags_.data());
      for_each_set(flags_, [&](std::size_t column) {
        transform_.add(static_cast<int>(column) + left, row + bottom, here[column] + kHalfCell);
      });
    }
    transform_.run();
    for (int row = 0; row < disc_window.height; ++row) {
      merge_penumbra(transform_.row(row), row_of(field, field.penumbra, disc_window, row),
                     static_cast<std::size_t>(disc_window.width));
    }
    for (int row = 0; row < window_.height; ++row) {
      merge_cell_discs(max_rho_.data() + index_of(0, row),
                       row_of(field, field.penumbra, window_, row),
                       static_cast<std::size_t>(window_.width));
    }
  }

  // Near the outline, values approximate signed distances. Requires the unclipped outline.
  void add_middle(ShadowField& field) {
    const auto stride = static_cast<std::size_t>(window_.width);
    middle_.resize(min_rho_.size());
    for (std::size_t i = 0; i < middle_.size(); ++i) middle_[i] = covered(i) ? 1.0F : -1.0F;
    for (const std::uint32_t i : outline_) {
      const auto set_zero = [&](std::size_t neighbour, float distance) {
        if (!covered(neighbour) || distance == kInfinity) return;
        // The interpolated zero between the two centres lies on the outline.
        middle_[i] = std::max(middle_[i], -distance);
        middle_[neighbour] = std::min(middle_[neighbour], 1.0F - distance);
      };
      set_zero(i - 1, gaps_.x[i]);
      set_zero(i + 1, gaps_.x[i]);
      set_zero(i - stride, gaps_.y[i]);
      set_zero(i + stride, gaps_.y[i]);
    }
    for (int row = 0; row < window_.height; ++row) {
      merge_larger(middle_.data() + index_of(0, row), row_of(field, field.middle, window_, row),
                   stride);
    }
  }

  // Finds the uncovered cells next to the part below `level` (rho <= level; rho grows with height).
  void find_outline(float level) {
    level_ = level;
    outline_.clear();
    for (int row = 1; row + 1 < window_.height; ++row) {
      const float* here = min_rho_.data() + index_of(0, row);
      flag_outline(here + window_.width, here, here - window_.width,
                   static_cast<std::size_t>(window_.width), level, column_min_.data(),
                   flags_.data());
      for_each_set(flags_, [&](std::size_t column) {
        outline_.push_back(static_cast<std::uint32_t>(index_of(0, row) + column));
      });
    }
  }

  // Measures, for outline cells that higher faces cover, the distance from the cell centre to the
  // part below the outline's level. `points` and `corners` are those of cover().
  void find_cut_gaps(std::span<const FieldPoint> points, std::span<const std::uint32_t> corners) {
    cut_gaps_.start(min_rho_.size());
    if (!mark_tiles([this](std::uint32_t i) { return covered(i); })) return;
    for (std::size_t i = 0; i + 2 < corners.size(); i += 3) {
      std::array<FieldPoint, 3> face = {points[corners[i]], points[corners[i + 1]],
                                        points[corners[i + 2]]};
      if (std::min({face[0].rho, face[1].rho, face[2].rho}) >= level_ || !touches_marked_tile(face))
        continue;
      std::ranges::sort(face, {}, &FieldPoint::rho);
      const auto& [low, middle, high] = face;
      if (high.rho <= level_) {
        lower_gaps(low, middle, high, cut_gaps_);
        continue;
      }
      // rho is linear over a projected face, so the clip line is straight.
      const FieldPoint on_long = at_level(low, high, level_);
      if (middle.rho < level_) {
        lower_gaps(low, middle, on_long, cut_gaps_);
        lower_gaps(middle, at_level(middle, high, level_), on_long, cut_gaps_);
      } else {
        lower_gaps(low, at_level(low, middle, level_), on_long, cut_gaps_);
      }
    }
  }

  // Adds the umbra of the part below the level of find_outline().
  void add_umbra(ShadowField& field) {
    transform_.start(window_.width, window_.height);
    const auto stride = static_cast<std::ptrdiff_t>(window_.width);
    const std::array<std::ptrdiff_t, 8> steps = {-1,          1,           -stride,    stride,
                                                 -stride - 1, -stride + 1, stride - 1, stride + 1};
    for (const std::uint32_t i : outline_) {
      float rho = kInfinity;
      for (std::size_t direction = 0; direction < steps.size(); ++direction) {
        // Diagonal neighbours, deeper inside, count only if no side neighbour is covered.
        if (direction == 4 && rho < kInfinity) break;
        rho = std::min(rho, outline_rho(i, steps[direction]));
      }
      if (rho == kInfinity) continue;
      const int row = static_cast<int>(i) / window_.width;
      transform_.add(static_cast<int>(i) - row * window_.width, row, rho + gap(i));
    }
    transform_.run();
    for (int row = 0; row < window_.height; ++row) {
      merge_umbra(transform_.row(row), min_rho_.data() + index_of(0, row), level_,
                  row_of(field, field.umbra, window_, row),
                  static_cast<std::size_t>(window_.width));
    }
  }

 private:
  // Distances from cell centres to the part along row and column [cells]; infinity: none.
  struct Gaps {
    std::vector<float> x, y;
    void start(std::size_t count) {
      x.assign(count, kInfinity);
      y.assign(count, kInfinity);
    }
  };

  [[nodiscard]] std::size_t index_of(int column, int row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(window_.width) +
           static_cast<std::size_t>(column);
  }
  // Returns the cells of a window's row in a layer of the field.
  static float* row_of(const ShadowField& field, std::vector<float>& layer, const Window& window,
                       int row) {
    return layer.data() +
           static_cast<std::size_t>(row + window.bottom) * static_cast<std::size_t>(field.width) +
           static_cast<std::size_t>(window.left);
  }
  [[nodiscard]] bool covered(std::size_t index) const { return min_rho_[index] < kInfinity; }

  // Returns rho at the outline between an uncovered cell and its neighbour at `step`, or infinity.
  // A lower surface that rises towards the outline, as on a round body, is extrapolated by half a
  // cell, but not beyond the upper surface.
  [[nodiscard]] float outline_rho(std::size_t uncovered, std::ptrdiff_t step) const {
    const std::size_t near = uncovered + static_cast<std::size_t>(step);
    if (!(min_rho_[near] <= level_)) return kInfinity;
    if (covered(uncovered)) return min_rho_[near];
    const std::size_t deep = near + static_cast<std::size_t>(step);
    if (!(min_rho_[deep] <= level_)) return min_rho_[near];
    const float rise = std::max(0.0F, min_rho_[near] - min_rho_[deep]);
    const float high_near = std::min(max_rho_[near], level_);
    const float fall = std::max(0.0F, std::min(max_rho_[deep], level_) - high_near);
    if (rise <= 0.0F) return min_rho_[near];
    return min_rho_[near] +
           rise * std::min(kHalfCell, (high_near - min_rho_[near]) / (rise + fall));
  }

  // Lowers the gaps of the cells beside a triangle, along rows and along columns.
  void lower_gaps(const FieldPoint& a, const FieldPoint& b, const FieldPoint& c, Gaps& gaps) const {
    const float area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if (area == 0.0F) return;
    const auto lower = [](const FieldSpan& span, float& before, float& after) {
      before = std::min(before, span.from - (static_cast<float>(span.first) - 0.5F));
      after = std::min(after, static_cast<float>(span.end) + 0.5F - span.to);
    };
    const bool covers_rows = for_each_span(a, b, c, window_, [&](const FieldSpan& span) {
      lower(span, gaps.x[index_of(span.first - 1, span.line)],
            gaps.x[index_of(span.end, span.line)]);
    });
    if (!covers_rows) return;
    const auto transposed = [](const FieldPoint& p) { return FieldPoint{p.y, p.x, p.rho}; };
    for_each_span(transposed(a), transposed(b), transposed(c),
                  {window_.bottom, window_.left, window_.height, window_.width},
                  [&](const FieldSpan& span) {
                    lower(span, gaps.y[index_of(span.line, span.first - 1)],
                          gaps.y[index_of(span.line, span.end)]);
                  });
  }

  // Marks the tiles with outline cells that are wanted. Returns false if there are none.
  template <class Wanted>
  bool mark_tiles(const Wanted& wanted) {
    tile_columns_ = window_.width / kTile + 1;
    tiles_.assign(static_cast<std::size_t>(tile_columns_) *
                      (static_cast<std::size_t>(window_.height / kTile) + 1),
                  0);
    bool any = false;
    for (const std::uint32_t i : outline_) {
      if (!wanted(i)) continue;
      any = true;
      const int row = static_cast<int>(i) / window_.width;
      const int column = static_cast<int>(i) - row * window_.width;
      tiles_[static_cast<std::size_t>(row / kTile * tile_columns_ + column / kTile)] = 1;
    }
    return any;
  }

  [[nodiscard]] bool touches_marked_tile(const std::array<FieldPoint, 3>& face) const {
    const auto [left, right] = std::minmax({face[0].x, face[1].x, face[2].x});
    const auto [low, high] = std::minmax({face[0].y, face[1].y, face[2].y});
    // Faces are two cells inside the window; the gaps of the adjacent centres are included.
    const int first_column = static_cast<int>(left - 1.0F) - window_.left;
    const int last_column = static_cast<int>(right + 1.0F) - window_.left;
    const int first_row = static_cast<int>(low - 1.0F) - window_.bottom;
    const int last_row = static_cast<int>(high + 1.0F) - window_.bottom;
    for (int row = first_row / kTile; row <= last_row / kTile; ++row) {
      for (int column = first_column / kTile; column <= last_column / kTile; ++column) {
        if (tiles_[static_cast<std::size_t>(row * tile_columns_ + column)] != 0) return true;
      }
    }
    return false;
  }

  // Returns the distance from an uncovered cell's centre to the adjacent outline [cells]; half a
  // cell if only a diagonal neighbour is covered.
  [[nodiscard]] float gap(std::size_t i) const {
    float x = covered(i) ? kInfinity : gaps_.x[i];
    float y = covered(i) ? kInfinity : gaps_.y[i];
    if (level_ < kUnclipped) {
      x = std::min(x, cut_gaps_.x[i]);
      y = std::min(y, cut_gaps_.y[i]);
    }
    if (x < kInfinity && y < kInfinity) {
      const float sum = x * x + y * y;
      return sum > 0.0F ? x * y / std::sqrt(sum) : 0.0F;
    }
    const float smaller = std::min(x, y);
    return smaller < kInfinity ? smaller : kHalfCell;
  }

  static FieldPoint at_level(const FieldPoint& low, const FieldPoint& high, float level) {
    const float t = (level - low.rho) / (high.rho - low.rho);
    return {low.x + t * (high.x - low.x), low.y + t * (high.y - low.y), level};
  }

  Window window_;
  std::vector<float> max_rho_, min_rho_;  // rho per cell; uncovered: -1 and infinity
  Gaps gaps_, cut_gaps_;
  float level_ = kUnclipped;            // maximum rho inside the outline
  std::vector<std::uint32_t> outline_;  // indices of cells
  static constexpr int kTile = 4;       // side of a tile [cells]
  int tile_columns_ = 0;
  std::vector<std::uint8_t> tiles_;
  std::vector<float> middle_, column_min_;
  std::vector<std::uint8_t> flags_;
  PowerTransform transform_;
};

}  // namespace

ShadowField power_distance_layers(std::span<const CasterVertex> vertices,
                                  std::span<const std::uint32_t> indices,
                                  std::span<const std::uint32_t> part,
                                  std::span<const PartLight> lights,
                                  const LayeredConstants& constants,
                                  const ShadowFieldOptions& options) {
  ShadowField field;
  ProjectedParts projected = project_parts(vertices, indices, part, lights, constants);
  if (projected.parts.empty()) return field;
  const Eigen::Vector2f low = projected.disc_bounds.min();
  const Eigen::Vector2f size = projected.disc_bounds.sizes();
  const float extent = size.maxCoeff();
  if (!(extent > 0.0F)) return field;

  constexpr int kMargin = 3;
  constexpr float kMinCells = 24.0F;  // along the longer side
  const float cell =
      std::max(extent / static_cast<float>(std::max(8, options.cells) - 2 * kMargin),
               std::min(static_cast<float>(options.finest_cell), extent / kMinCells));
  if (!(cell > std::numeric_limits<float>::min())) return field;
  field.cell = static_cast<double>(cell);
  field.width = static_cast<int>(std::ceil(size.x() / cell)) + 2 * kMargin;
  field.height = static_cast<int>(std::ceil(size.y() / cell)) + 2 * kMargin;
  const float left = low.x() - static_cast<float>(kMargin) * cell;
  const float bottom = low.y() - static_cast<float>(kMargin) * cell;
  field.origin = {static_cast<double>(left), static_cast<double>(bottom)};
  const std::size_t count =
      static_cast<std::size_t>(field.width) * static_cast<std::size_t>(field.height);
  field.umbra.assign(count, -PowerTransform::kFar);
  field.middle.assign(count, -1.0F);
  field.penumbra.assign(count, -PowerTransform::kFar);

  for (FieldPoint& point : projected.points)
    point = {(point.x - left) / cell, (point.y - bottom) / cell, point.rho / cell};
  const auto window_of = [&](const Eigen::AlignedBox2f& bounds) {
    const auto to_cells = [cell](float value, float from) {
      return static_cast<int>((value - from) / cell);
    };
    Window window;
    window.left = std::max(0, to_cells(bounds.min().x(), left) - 2);
    window.bottom = std::max(0, to_cells(bounds.min().y(), bottom) - 2);
    window.width = std::min(field.width, to_cells(bounds.max().x(), left) + 4) - window.left;
    window.height = std::min(field.height, to_cells(bounds.max().y(), bottom) + 4) - window.bottom;
    return window;
  };
  // Keeps its memory, which the kernel would clear again for each field.
  thread_local PartField part_field;
  for (const ProjectedPart& projected_part : projected.parts) {
    const auto faces =
        std::span(projected.corners)
            .subspan(projected_part.begin, projected_part.end - projected_part.begin);
    part_field.cover(projected.points, faces, window_of(projected_part.corner_bounds));
    part_field.find_outline(kUnclipped);
    part_field.find_gaps(projected.points, faces);
    part_field.add_umbra(field);
    part_field.add_penumbra(window_of(projected_part.disc_bounds), field);
    part_field.add_middle(field);
    float previous_rho = projected_part.top / cell;
    for (const float level : projected_part.levels) {
      const float rho = level / cell;
      constexpr float kFlat = 0.1F;  // parts with a smaller range of rho have one outline [cells]
      if (level < 0.0F || previous_rho - rho < kFlat) continue;
      part_field.find_outline(rho);
      part_field.find_cut_gaps(projected.points, faces);
      part_field.add_umbra(field);
      previous_rho = rho;
    }
  }
  return field;
}

}  // namespace penumbra
