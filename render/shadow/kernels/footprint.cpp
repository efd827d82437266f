#include "render/shadow/kernels/footprint.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "core/vector_clones.hpp"

namespace penumbra {

namespace {

constexpr int kMaxSideCells = 512;
constexpr std::size_t kWordCells = 64;
constexpr std::size_t kRowBlock = 8;  // a row's stride is a multiple of this [cells]
// Cells with centres this close to a face are covered, so that rounding opens no cracks.
constexpr float kEdgeTolerance = 1e-3F;  // [cells]
// Fractions of a silhouette's size.
constexpr float kFlatCorner = 1e-6F;  // larger than the deviation of an edge by rounding
constexpr float kShortEdge = 1e-2F;   // shorter edges have no direction
// Cosine and sine of 0.37 rad: no edge or corner of a regular shape is at this angle to another.
constexpr float kAskewCosine = 0.93232F;
constexpr float kAskewSine = 0.36162F;
constexpr float kMaxEqualRatio = 1.001F;  // areas or sides with a smaller ratio count as equal

float cross(const Eigen::Vector2f& a, const Eigen::Vector2f& b) {
  return a.x() * b.y() - a.y() * b.x();
}

// Computes squared[x] = min over x' of (x - x')^2 + g2[x'] within each row, from small to large |x
// - x'| until no value can decrease. Rows begin and end with a 0, which keeps neighbouring rows
// from contributing; a margin row precedes the first row and follows the last. Exact, as all values
// are small integers. Their bit patterns compare like the values.
PENUMBRA_VECTOR_CLONES
void transform_rows(const float* __restrict g2, float* __restrict squared, std::size_t rows,
                    std::size_t stride, std::size_t width) {
  for (std::size_t row = 0; row < rows; ++row) {
    const float* here = g2 + row * stride;
    float* out = squared + row * stride;
    for (std::size_t dx = 1; 2 * dx < width; dx += 4) {
      const std::size_t first = dx / kRowBlock * kRowBlock;  // whole vectors
      const std::size_t count = (width - dx + kRowBlock - 1) / kRowBlock * kRowBlock - first;
      const auto step = static_cast<float>(dx * dx);
      const auto step_1 = static_cast<float>((dx + 1) * (dx + 1));
      const auto step_2 = static_cast<float>((dx + 2) * (dx + 2));
      const auto step_3 = static_cast<float>((dx + 3) * (dx + 3));
      const float* left = here + first - dx;
      const float* right = here + first + dx;
      float* lowered = out + first;
      std::int32_t largest = 0;
      for (std::size_t x = 0; x < count; ++x) {
        const auto at = static_cast<std::ptrdiff_t>(x);
        const float near = step + (left[at] < right[at] ? left[at] : right[at]);
        const float near_1 = step_1 + (left[at - 1] < right[at + 1] ? left[at - 1] : right[at + 1]);
        const float near_2 = step_2 + (left[at - 2] < right[at + 2] ? left[at - 2] : right[at + 2]);
        const float near_3 = step_3 + (left[at - 3] < right[at + 3] ? left[at - 3] : right[at + 3]);
        const float nearer = near < near_1 ? near : near_1;
        const float farther = near_2 < near_3 ? near_2 : near_3;
        const float nearest = nearer < farther ? nearer : farther;
        const float value = nearest < lowered[x] ? nearest : lowered[x];
        lowered[x] = value;
        const auto bits = std::bit_cast<std::int32_t>(value);
        largest = bits > largest ? bits : largest;
      }
      const auto next = static_cast<float>((dx + 4) * (dx + 4));
      if (std::bit_cast<float>(largest) <= next) break;
    }
  }
}

PENUMBRA_VECTOR_CLONES
void replace_by_roots(float* values, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) values[i] = std::sqrt(values[i]);
}

// Sets here[x] = before[x] + 1 if covered, else 0.
PENUMBRA_VECTOR_CLONES
void step_down(const float* before, const float* covered, float* __restrict here,
               std::size_t width) {
  for (std::size_t x = 0; x < width; ++x) here[x] = (before[x] + 1.0F) * covered[x];
}

// Sets here[x] = min(here[x], below[x] + 1).
PENUMBRA_VECTOR_CLONES
void step_up(const float* below, float* __restrict here, std::size_t width) {
  for (std::size_t x = 0; x < width; ++x) {
    const float step = below[x] + 1.0F;
    here[x] = step < here[x] ? step : here[x];
  }
}

// Squares `values`, and copies the squares.
PENUMBRA_VECTOR_CLONES
void square_and_copy(float* __restrict values, float* __restrict squares, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    const float square = values[i] * values[i];
    values[i] = square;
    squares[i] = square;
  }
}

// Converts the cells of a row from bits to floats, in blocks of eight.
PENUMBRA_VECTOR_CLONES
void spread_bits(const std::uint64_t* words, std::size_t blocks, float* cells) {
  for (std::size_t block = 0; block < blocks; ++block) {
    const auto eight = static_cast<std::int32_t>(words[block / 8] >> (block % 8 * 8) & 0xffU);
    for (std::size_t i = 0; i < kRowBlock; ++i) {
      cells[block * kRowBlock + i] = (eight & (1 << i)) != 0 ? 1.0F : 0.0F;
    }
  }
}

// Returns the number of runs of covered cells in a row. The cell before the row is not covered.
PENUMBRA_VECTOR_CLONES
std::int32_t runs_of(const float* row, std::size_t width) {
  std::int32_t runs = 0;
  const float* before = row - 1;
  for (std::size_t x = 0; x < width; ++x) runs += row[x] > before[x] ? 1 : 0;
  return runs;
}

// Andrew's monotone chain; sorts `points`. Drops corners that deviate from an edge by `flat` or
// less, as rounding may cause.
void convex_hull(std::vector<Eigen::Vector2f>& points, float flat,
                 std::vector<Eigen::Vector2f>& hull) {
  std::sort(points.begin(), points.end(), [](const Eigen::Vector2f& a, const Eigen::Vector2f& b) {
    return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
  });
  hull.clear();
  const auto stands_out = [&](const Eigen::Vector2f& before, const Eigen::Vector2f& corner,
                              const Eigen::Vector2f& after) {
    const Eigen::Vector2f chord = after - before;
    return cross(corner - before, chord) > flat * chord.norm();
  };
  const auto extend = [&](const Eigen::Vector2f& p, std::size_t keep) {
    while (hull.size() >= keep + 2 && !stands_out(hull[hull.size() - 2], hull.back(), p)) {
      hull.pop_back();
    }
    hull.push_back(p);
  };
  for (const Eigen::Vector2f& p : points) extend(p, 0);
  const std::size_t lower = hull.size() - 1;
  for (std::size_t i = points.size(); i-- > 0;) extend(points[i], lower);
  if (hull.size() > 1) hull.pop_back();
}

// Finds points that include all corners of the convex hull. If there are many points, these are the
// points outside a polygon through the highest and lowest point of each column.
void gather_hull_candidates(std::span<const Eigen::Vector2f> points,
                            std::vector<Eigen::Vector2f>& candidates,
                            std::vector<Eigen::Vector2f>& hull) {
  constexpr std::size_t kColumns = 32;
  candidates.clear();
  if (points.size() <= 2 * kColumns) {
    candidates.assign(points.begin(), points.end());
    return;
  }
  Eigen::AlignedBox2f bounds;
  for (const Eigen::Vector2f& p : points) bounds.extend(p);
  const float left = bounds.min().x();
  const float right = bounds.max().x();
  struct Column {
    Eigen::Vector2f low, high;
    bool used = false;
  };
  std::array<Column, kColumns> columns;
  const float width = (right - left) / static_cast<float>(kColumns);
  const float scale = right > left ? 1.0F / width : 0.0F;
  const auto column_of = [&](const Eigen::Vector2f& p) {
    return std::min(static_cast<std::size_t>((p.x() - left) * scale), kColumns - 1);
  };
  for (const Eigen::Vector2f& p : points) {
    Column& column = columns[column_of(p)];
    if (!column.used) column = {p, p, true};
    if (p.y() < column.low.y()) column.low = p;
    if (p.y() > column.high.y()) column.high = p;
  }
  for (const Column& column : columns) {
    if (!column.used) continue;
    candidates.push_back(column.low);
    candidates.push_back(column.high);
  }
  convex_hull(candidates, 0.0F, hull);
  // Within a column, the hull lies outside the chords between its highest and lowest points.
  std::array<float, kColumns + 1> low, high;
  low.fill(std::numeric_limits<float>::infinity());
  high.fill(-std::numeric_limits<float>::infinity());
  float lowest = low[0];
  float highest = high[0];
  for (std::size_t i = 0; i < hull.size(); ++i) {
    const Eigen::Vector2f& a = hull[i];
    const Eigen::Vector2f& b = hull[(i + 1) % hull.size()];
    lowest = std::min(lowest, a.y());
    highest = std::max(highest, a.y());
    const auto [from, to] = std::minmax(a.x(), b.x());
    for (std::size_t border = 0; border <= kColumns; ++border) {
      const float x = left + width * static_cast<float>(border);
      if (x < from || x > to || a.x() == b.x()) continue;
      const float y = a.y() + (b.y() - a.y()) * ((x - a.x()) / (b.x() - a.x()));
      low[border] = std::min(low[border], y);
      high[border] = std::max(high[border], y);
    }
  }
  const float rounding = 1e-5F * (highest - lowest);
  candidates.clear();
  for (const Eigen::Vector2f& p : points) {
    const std::size_t column = column_of(p);
    const float fraction = (p.x() - left) * scale - static_cast<float>(column);
    const float bottom = low[column] + fraction * (low[column + 1] - low[column]) + rounding;
    const float top = high[column] + fraction * (high[column + 1] - high[column]) - rounding;
    if (p.y() > bottom && p.y() < top) continue;  // also false for the NaN of a vertical chord
    candidates.push_back(p);
  }
}

}  // namespace

// The minimum-area rectangle of a convex polygon has a side along an edge. Ties between rectangles,
// and between a rectangle's directions, are broken by the points and not by the axes or rounding,
// so that rotated points get the same raster.
void FootprintRaster::choose_axis(std::span<const Eigen::Vector2f> points, float size) {
  axis_ = Eigen::Vector2f::UnitX();
  rectangles_.clear();
  float min_area = std::numeric_limits<float>::infinity();
  Eigen::Vector2f middle = Eigen::Vector2f::Zero();
  for (std::size_t i = 0; i < hull_.size(); ++i) {
    middle += hull_[i] / static_cast<float>(hull_.size());
    const Eigen::Vector2f edge = hull_[(i + 1) % hull_.size()] - hull_[i];
    const float length = edge.norm();
    if (!(length > kShortEdge * size)) continue;  // too short to have a direction
    Rectangle rectangle;
    rectangle.along = edge / length;
    float first = std::numeric_limits<float>::infinity();
    float last = -first;
    for (const Eigen::Vector2f& p : hull_) {
      const Eigen::Vector2f d = p - hull_[i];
      first = std::min(first, rectangle.along.dot(d));
      last = std::max(last, rectangle.along.dot(d));
      rectangle.height = std::max(rectangle.height, cross(rectangle.along, d));
    }
    rectangle.width = last - first;
    min_area = std::min(min_area, rectangle.width * rectangle.height);
    rectangles_.push_back(rectangle);
  }
  if (rectangles_.empty()) return;
  // Direction from the middle to the first point clearly off it, rotated by an angle that prevents
  // ties between the four directions.
  Eigen::Vector2f reference = Eigen::Vector2f::UnitX();
  for (const Eigen::Vector2f& p : points) {
    const Eigen::Vector2f d = p - middle;
    if (d.norm() < 0.1F * size) continue;
    reference = {kAskewCosine * d.x() - kAskewSine * d.y(),
                 kAskewSine * d.x() + kAskewCosine * d.y()};
    break;
  }
  float best_alignment = -std::numeric_limits<float>::infinity();
  for (const Rectangle& rectangle : rectangles_) {
    if (rectangle.width * rectangle.height > kMaxEqualRatio * min_area) continue;
    const auto consider = [&](const Eigen::Vector2f& axis) {
      const float alignment = axis.dot(reference);
      if (alignment <= best_alignment) return;
      best_alignment = alignment;
      axis_ = axis;
    };
    // Rows lie along the longer side, because short columns make the distance transform cheap.
    if (kMaxEqualRatio * rectangle.width >= rectangle.height) {
      consider(rectangle.along);
      consider(-rectangle.along);
    }
    if (kMaxEqualRatio * rectangle.height >= rectangle.width) {
      const Eigen::Vector2f across(-rectangle.along.y(), rectangle.along.x());
      consider(across);
      consider(-across);
    }
  }
}

bool FootprintRaster::fit(std::span<const Eigen::Vector2f> points, int cell_budget) {
  width_ = height_ = 0;
  stride_ = 0;
  if (points.empty()) return false;
  gather_hull_candidates(points, hull_candidates_, hull_);
  float size = 0.0F;
  for (const Eigen::Vector2f& p : hull_candidates_) {
    size = std::max(size, (p - points[0]).squaredNorm());
  }
  size = std::sqrt(size);
  convex_hull(hull_candidates_, kFlatCorner * size, hull_);
  choose_axis(points, size);

  Eigen::AlignedBox2f box;  // coordinates along and across the axis
  for (const Eigen::Vector2f& p : hull_) box.extend(Eigen::Vector2f(axis_.dot(p), cross(axis_, p)));
  const Eigen::Vector2f extent = box.sizes();
  const float longer = extent.maxCoeff();
  cell_ = std::max(std::sqrt(extent.x() * extent.y() / static_cast<float>(cell_budget)),
                   longer / static_cast<float>(kMaxSideCells));
  if (!(cell_ > std::numeric_limits<float>::min()) || !std::isfinite(cell_)) return false;
  const auto cells_along = [this](float length) {
    // The tolerance keeps rounding from adding a cell to a side.
    return std::clamp(static_cast<int>(std::ceil(length / cell_ - kEdgeTolerance)), 1,
                      kMaxSideCells) +
           2;
  };
  width_ = cells_along(extent.x());
  height_ = cells_along(extent.y());
  stride_ = (static_cast<std::size_t>(width_) + kRowBlock - 1) / kRowBlock * kRowBlock;
  // The raster is centred, so that a symmetric silhouette gets a symmetric raster.
  const Eigen::Vector2f corner =
      0.5F * (box.min() + box.max()) -
      0.5F * cell_ * Eigen::Vector2f(static_cast<float>(width_), static_cast<float>(height_));
  origin_ = {axis_.x() * corner.x() - axis_.y() * corner.y(),
             axis_.y() * corner.x() + axis_.x() * corner.y()};
  return true;
}

bool FootprintRaster::cover(std::span<const Eigen::Vector2f> points,
                            std::span<const std::uint32_t> faces, int cell_budget) {
  if (!fit(points, cell_budget)) return false;
  row_words_ = (stride_ + kWordCells - 1) / kWordCells;
  bits_.assign(static_cast<std::size_t>(height_) * row_words_, 0);
  cells_.resize(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) cells_[i] = to_cells(points[i]);
  for (std::size_t i = 0; i + 2 < faces.size(); i += 3) {
    cover_triangle(cells_[faces[i]], cells_[faces[i + 1]], cells_[faces[i + 2]]);
  }
  // A silhouette thinner than a cell misses most centres, so its edges are covered too.
  std::size_t covered = 0;
  for (const std::uint64_t word : bits_) covered += static_cast<std::size_t>(std::popcount(word));
  if (covered < static_cast<std::size_t>(std::max(width_, height_))) {
    for (std::size_t i = 0; i + 2 < faces.size(); i += 3) {
      for (std::size_t corner = 0; corner < 3; ++corner) {
        cover_segment(cells_[faces[i + corner]], cells_[faces[i + (corner + 1) % 3]]);
      }
    }
  }
  covered_.resize(row_offset(height_));
  for (int row = 0; row < height_; ++row) {
    spread_bits(bits_.data() + static_cast<std::size_t>(row) * row_words_, stride_ / kRowBlock,
                covered_.data() + row_offset(row));
  }
  return true;
}

void FootprintRaster::cover_triangle(Eigen::Vector2f a, Eigen::Vector2f b, Eigen::Vector2f c) {
  // Coordinates are > 0 because of the margin, so truncation rounds down.
  const auto first_centre_from = [](float x) {
    return static_cast<int>(x + (0.5F - kEdgeTolerance));
  };
  const auto end_of_centres_at = [](float x) {
    return static_cast<int>(x + (0.5F + kEdgeTolerance));
  };
  if (b.y() < a.y()) std::swap(a, b);
  if (c.y() < b.y()) std::swap(b, c);
  if (b.y() < a.y()) std::swap(a, b);
  const int first_row = std::max(0, first_centre_from(a.y()));
  const int end_row = std::min(height_, end_of_centres_at(c.y()));
  if (first_row >= end_row) return;
  const auto slope = [](const Eigen::Vector2f& from, const Eigen::Vector2f& to) {
    const float rise = to.y() - from.y();
    return rise > 0.0F ? (to.x() - from.x()) / rise : 0.0F;
  };
  const float slope_ac = slope(a, c);
  const float slope_ab = slope(a, b);
  const float slope_bc = slope(b, c);
  for (int row = first_row; row < end_row; ++row) {
    const float y = std::clamp(static_cast<float>(row) + 0.5F, a.y(), c.y());
    const float x_on_ac = a.x() + (y - a.y()) * slope_ac;
    const float x_on_abc =
        y < b.y() ? a.x() + (y - a.y()) * slope_ab : b.x() + (y - b.y()) * slope_bc;
    float left = std::min(x_on_ac, x_on_abc);
    float right = std::max(x_on_ac, x_on_abc);
    if (a.y() == c.y()) {  // a triangle without height has all corners in this row
      left = std::min(left, c.x());
      right = std::max(right, c.x());
    }
    const int first = std::max(0, first_centre_from(left));
    const int end = std::min(width_, end_of_centres_at(right));
    if (first < end) {
      cover_cells(row, static_cast<std::size_t>(first), static_cast<std::size_t>(end));
    }
  }
}

void FootprintRaster::cover_segment(const Eigen::Vector2f& a, const Eigen::Vector2f& b) {
  const Eigen::Vector2f d = b - a;
  const int steps = std::max(1, static_cast<int>(std::ceil(d.cwiseAbs().maxCoeff())));
  for (int i = 0; i <= steps; ++i) {
    const Eigen::Vector2f p = a + d * (static_cast<float>(i) / static_cast<float>(steps));
    const int column = std::clamp(static_cast<int>(std::floor(p.x())), 1, width_ - 2);
    const int row = std::clamp(static_cast<int>(std::floor(p.y())), 1, height_ - 2);
    cover_cells(row, static_cast<std::size_t>(column), static_cast<std::size_t>(column) + 1);
  }
}

void FootprintRaster::cover_cells(int row, std::size_t first, std::size_t end) {
  std::uint64_t* words = bits_.data() + static_cast<std::size_t>(row) * row_words_;
  const std::size_t last_word = (end - 1) / kWordCells;
  std::uint64_t from = ~std::uint64_t{0} << first % kWordCells;
  for (std::size_t word = first / kWordCells; word < last_word; ++word) {
    words[word] |= from;
    from = ~std::uint64_t{0};
  }
  words[last_word] |= from & ~std::uint64_t{0} >> (kWordCells - 1 - (end - 1) % kWordCells);
}

std::size_t FootprintRaster::covered_count() const {
  return static_cast<std::size_t>(std::ranges::count(covered_, 1.0F));
}

void FootprintRaster::fill_small_holes(double share) {
  // A silhouette with one run per row, as most small parts have, has no hole.
  bool one_run_per_row = true;
  for (int row = 1; row + 1 < height_ && one_run_per_row; ++row) {
    one_run_per_row = runs_of(covered_row(row), stride()) <= 1;
  }
  if (one_run_per_row) return;

  // Joins runs of uncovered cells into 4-connected regions.
  runs_.clear();
  const auto root = [this](std::uint32_t i) {
    while (runs_[i].parent != i) {
      runs_[i].parent = runs_[runs_[i].parent].parent;
      i = runs_[i].parent;
    }
    return i;
  };
  std::size_t covered = 0;
  std::size_t above = 0;  // first run of the row above
  std::size_t row_begin = 0;
  for (int row = 0; row < height_; ++row) {
    const float* cells = covered_row(row);
    above = row_begin;
    row_begin = runs_.size();
    std::size_t candidate = above;
    for (int column = 0; column < width_;) {
      if (cells[column] != 0.0F) {
        ++covered;
        ++column;
        continue;
      }
      const int first = column;
      while (column < width_ && cells[column] == 0.0F) ++column;
      const auto index = static_cast<std::uint32_t>(runs_.size());
      const bool open = row == 0 || row == height_ - 1 || first == 0 || column == width_;
      runs_.push_back(
          {row, first, column - 1, index, static_cast<std::uint32_t>(column - first), open});
      while (candidate < row_begin && runs_[candidate].last < first) ++candidate;
      for (std::size_t other = candidate; other < row_begin && runs_[other].first < column;
           ++other) {
        const std::uint32_t a = root(index);
        const std::uint32_t b = root(static_cast<std::uint32_t>(other));
        if (a == b) continue;
        const std::uint32_t low = std::min(a, b);
        const std::uint32_t high = std::max(a, b);
        runs_[high].parent = low;
        runs_[low].size += runs_[high].size;
        runs_[low].open = runs_[low].open || runs_[high].open;
      }
    }
  }
  const double limit = share * static_cast<double>(covered);
  for (std::uint32_t i = 0; i < runs_.size(); ++i) {
    const Run& region = runs_[root(i)];
    if (region.open || region.size >= limit) continue;
    std::fill_n(
        covered_.begin() + static_cast<std::ptrdiff_t>(row_offset(runs_[i].row)) + runs_[i].first,
        runs_[i].last - runs_[i].first + 1, 1.0F);
  }
}

void FootprintRaster::bridge_gaps(int max_gap) {
  const auto bridge = [max_gap](float* cells, std::size_t step, int count) {
    int last = -1;  // previous covered cell
    for (int i = 0; i < count; ++i) {
      if (cells[static_cast<std::size_t>(i) * step] == 0.0F) continue;
      if (last >= 0 && i - last - 1 <= max_gap) {
        for (int gap = last + 1; gap < i; ++gap) cells[static_cast<std::size_t>(gap) * step] = 1.0F;
      }
      last = i;
    }
  };
  for (int row = 0; row < height_; ++row) bridge(covered_.data() + row_offset(row), 1, width_);
  for (int column = 0; column < width_; ++column) {
    bridge(covered_.data() + column, stride(), height_);
  }
}

void FootprintRaster::compute_depth() {
  depth_.resize(covered_.size());
  // Columns: distance to the nearest uncovered cell above or below. The margin bounds every column.
  std::fill_n(depth_.begin(), stride(), 0.0F);
  for (int row = 1; row < height_; ++row) {
    step_down(depth_.data() + row_offset(row - 1), covered_row(row),
              depth_.data() + row_offset(row), stride());
  }
  for (int row = height_ - 2; row >= 0; --row) {
    step_up(depth_.data() + row_offset(row + 1), depth_.data() + row_offset(row), stride());
  }
  // Rows: D(x)^2 = min over x' of (x - x')^2 + g(x')^2. The margin's rows stay 0.
  squared_column_distance_.resize(depth_.size());
  square_and_copy(depth_.data(), squared_column_distance_.data(), depth_.size());
  const auto inner_rows = static_cast<std::size_t>(std::max(height_ - 2, 0));
  float* squared = depth_.data() + stride();
  transform_rows(squared_column_distance_.data() + stride(), squared, inner_rows, stride(),
                 static_cast<std::size_t>(width_));
  replace_by_roots(squared, inner_rows * stride());
}

Eigen::Vector2f FootprintRaster::centroid() const {
  double sum_column = 0.0;
  double sum_row = 0.0;
  std::size_t count = 0;
  for (int row = 0; row < height_; ++row) {
    const float* cells = covered_row(row);
    for (int column = 0; column < width_; ++column) {
      if (cells[column] == 0.0F) continue;
      sum_column += column;
      sum_row += row;
      ++count;
    }
  }
  if (count == 0) {
    return from_cells({0.5F * static_cast<float>(width_), 0.5F * static_cast<float>(height_)});
  }
  const auto n = static_cast<double>(count);
  return from_cells(
      {static_cast<float>(sum_column / n + 0.5), static_cast<float>(sum_row / n + 0.5)});
}

}  // namespace penumbra
