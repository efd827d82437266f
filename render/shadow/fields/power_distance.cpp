#include "render/shadow/fields/power_distance.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <optional>

#include "core/vector_clones.hpp"
#include "render/shadow/fields/power_transform.hpp"

namespace penumbra {

namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kAllMatter = std::numeric_limits<float>::max();  // as a level of rho
// A cell stands for its whole square, so its disc is half a cell larger.
constexpr float kHalfCell = 0.5F;
// Far from the light's axis the largest outline belongs to the top of a part and the best umbra to
// matter further down: the umbra is the union of those of all matter and of matter below these
// shares of the part's height.
constexpr std::array<double, 2> kLevels = {0.5, 0.02};

// A projected corner: position on the plane and radius of the light's image there.
struct FieldPoint {
  float x, y, rho;
};

// Rectangle of cells of the whole field.
struct Window {
  int left = 0, bottom = 0, width = 0, height = 0;
};

// flags[x] = 1 where a cell's value is above the level and one of its eight neighbours' is not;
// for x in [1, width - 1).
PENUMBRA_VECTOR_CLONES
void flag_outline(const float* above, const float* here, const float* below, std::size_t width,
                  float level, float* column_least, std::uint8_t* flags) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // different arrays, here and below
#endif
  for (std::size_t x = 0; x < width; ++x) {
    const float least = above[x] < below[x] ? above[x] : below[x];
    column_least[x] = least < here[x] ? least : here[x];
  }
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep
#endif
  for (std::size_t x = 1; x + 1 < width; ++x) {
    const float beside =
        column_least[x - 1] < column_least[x + 1] ? column_least[x - 1] : column_least[x + 1];
    const float least = beside < column_least[x] ? beside : column_least[x];
    const bool outline = (least <= level) & (here[x] > level);
    flags[x] = outline ? 1 : 0;
  }
}

// flags[x] = 1 where a covered cell's disc may reach beyond those of its four neighbours. `rows`
// hold the greatest rho, -1 where not covered. A neighbour q in the direction of a point z is at
// least 0.707 nearer to z than p along the line: |z - q|^2 <= d^2 - 1.414 d + 1 with d = |z - p|,
// so q does for every z on p's rim, and 3/2 cells inside of it, what p does, where
//   r_p^2 - r_q^2 <= 1.414 (r_p - 1.5) - 1.
PENUMBRA_VECTOR_CLONES
void flag_reaching(const float* above, const float* here, const float* below, std::size_t width,
                   std::uint8_t* flags) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep
#endif
  for (std::size_t x = 1; x + 1 < width; ++x) {
    const float upright = above[x] < below[x] ? above[x] : below[x];
    const float level = here[x - 1] < here[x + 1] ? here[x - 1] : here[x + 1];
    const float least = upright < level ? upright : level;
    const float own = here[x] + kHalfCell;
    const float least_beside = least + kHalfCell;
    const bool reaches =
        (least < 0.0F) | (own * own - least_beside * least_beside > 1.4142F * (own - 1.5F) - 1.0F);
    flags[x] = ((here[x] >= 0.0F) & reaches) ? 1 : 0;
  }
}

// to[x] = max(to[x], own disc of a covered cell or, beyond, -distance).
PENUMBRA_VECTOR_CLONES
void merge_penumbra(const float* distance, float* to, std::size_t count) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep
#endif
  for (std::size_t x = 0; x < count; ++x) to[x] = to[x] > -distance[x] ? to[x] : -distance[x];
}
PENUMBRA_VECTOR_CLONES
void merge_own_discs(const float* greatest, float* to, std::size_t count) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep
#endif
  for (std::size_t x = 0; x < count; ++x) {
    const float radius = greatest[x] + kHalfCell;
    const float own = greatest[x] >= 0.0F ? radius * radius : to[x];
    to[x] = to[x] > own ? to[x] : own;
  }
}
// Covered up to the level: distance; beyond: minus its size.
PENUMBRA_VECTOR_CLONES
void merge_umbra(const float* distance, const float* least, float level, float* to,
                 std::size_t count) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep
#endif
  for (std::size_t x = 0; x < count; ++x) {
    const float outside = distance[x] < 0.0F ? distance[x] : -distance[x];
    const float value = least[x] <= level ? distance[x] : outside;
    to[x] = to[x] > value ? to[x] : value;
  }
}
PENUMBRA_VECTOR_CLONES
void merge_larger(const float* from, float* to, std::size_t count) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep
#endif
  for (std::size_t x = 0; x < count; ++x) to[x] = to[x] > from[x] ? to[x] : from[x];
}

// One part's matter on the raster, and the layers that come of it. One object serves many parts one
// after another without allocating anew.
class PartField {
 public:
  // The window holds all corners, with two cells more on each side. Corners are in cells of the
  // whole field.
  void cover(std::span<const FieldPoint> points, std::span<const std::uint32_t> corners,
             const Window& window) {
    window_ = window;
    const std::size_t count =
        static_cast<std::size_t>(window.width) * static_cast<std::size_t>(window.height);
    greatest_.assign(count, -1.0F);
    least_.assign(count, kInfinity);
    gaps_.start(count);
    column_least_.resize(static_cast<std::size_t>(window.width));
    // Whole blocks of eight; the window's border is never flagged.
    flags_.assign((static_cast<std::size_t>(window.width) + 7) / 8 * 8, 0);
    for (std::size_t i = 0; i + 2 < corners.size(); i += 3) {
      cover_triangle(points[corners[i]], points[corners[i + 1]], points[corners[i + 2]], gaps_);
    }
  }

  // Field value > 0 where some covered cell's disc reaches. `reach`: the cells that it can.
  void add_penumbra(const Window& reach, ShadowField& field) {
    transform_.start(reach.width, reach.height);
    const int left = window_.left - reach.left;
    const int bottom = window_.bottom - reach.bottom;
    for (int row = 1; row + 1 < window_.height; ++row) {
      const float* here = greatest_.data() + index_of(0, row);
      flag_reaching(here + window_.width, here, here - window_.width,
                    static_cast<std::size_t>(window_.width), flags_.data());
      for_each_flagged([&](std::size_t column) {
        transform_.add(static_cast<int>(column) + left, row + bottom, here[column] + kHalfCell);
      });
    }
    transform_.run();
    for (int row = 0; row < reach.height; ++row) {
      merge_penumbra(transform_.row(row), row_of(field, field.penumbra, reach, row),
                     static_cast<std::size_t>(reach.width));
    }
    for (int row = 0; row < window_.height; ++row) {
      merge_own_discs(greatest_.data() + index_of(0, row),
                      row_of(field, field.penumbra, window_, row),
                      static_cast<std::size_t>(window_.width));
    }
  }

  // Roughly the signed distance to the outline, right beside it: > 0 in covered cells. The outline
  // found must be that of all matter.
  void add_middle(ShadowField& field) {
    const auto stride = static_cast<std::size_t>(window_.width);
    middle_.resize(least_.size());
    for (std::size_t i = 0; i < middle_.size(); ++i)
      middle_[i] = least_[i] < kInfinity ? 1.0F : -1.0F;
    for (const std::uint32_t i : outline_) {
      const auto along = [&](std::size_t beside, float distance) {
        if (!covered(beside) || distance == kInfinity) return;
        // The zero between the two centres falls on the outline.
        middle_[i] = std::max(middle_[i], -distance);
        middle_[beside] = std::min(middle_[beside], 1.0F - distance);
      };
      along(i - 1, gaps_.x[i]);
      along(i + 1, gaps_.x[i]);
      along(i - stride, gaps_.y[i]);
      along(i + stride, gaps_.y[i]);
    }
    for (int row = 0; row < window_.height; ++row) {
      merge_larger(middle_.data() + index_of(0, row), row_of(field, field.middle, window_, row),
                   stride);
    }
  }

  // Finds the cells just outside of the matter whose rho is at most `level`: rho grows with the
  // height. For add_umbra() and add_middle().
  void find_outline(float level) {
    level_ = level;
    outline_.clear();
    for (int row = 1; row + 1 < window_.height; ++row) {
      const float* here = least_.data() + index_of(0, row);
      flag_outline(here + window_.width, here, here - window_.width,
                   static_cast<std::size_t>(window_.width), level, column_least_.data(),
                   flags_.data());
      for_each_flagged([&](std::size_t column) {
        outline_.push_back(static_cast<std::uint32_t>(index_of(0, row) + column));
      });
    }
  }

  // Where the outline found runs over higher matter: how far the matter below the level, cut at it,
  // is from the centres beside it. The points and corners are those that were covered.
  void find_cut_gaps(std::span<const FieldPoint> points, std::span<const std::uint32_t> corners) {
    cut_gaps_.start(least_.size());
    const int tile_columns = window_.width / kTile + 1;
    tiles_.assign(static_cast<std::size_t>(tile_columns) *
                      (static_cast<std::size_t>(window_.height / kTile) + 1),
                  0);
    bool over_matter = false;
    for (const std::uint32_t i : outline_) {
      if (!covered(i)) continue;
      over_matter = true;
      const int row = static_cast<int>(i) / window_.width;
      const int column = static_cast<int>(i) - row * window_.width;
      tiles_[static_cast<std::size_t>(row / kTile * tile_columns + column / kTile)] = 1;
    }
    if (!over_matter) return;
    const auto touches = [&](const std::array<FieldPoint, 3>& face) {
      const auto [left, right] = std::minmax({face[0].x, face[1].x, face[2].x});
      const auto [low, high] = std::minmax({face[0].y, face[1].y, face[2].y});
      // Faces lie inside the window by two cells; gaps are of the next centres.
      const int first_column = static_cast<int>(left - 1.0F) - window_.left;
      const int last_column = static_cast<int>(right + 1.0F) - window_.left;
      const int first_row = static_cast<int>(low - 1.0F) - window_.bottom;
      const int last_row = static_cast<int>(high + 1.0F) - window_.bottom;
      for (int row = first_row / kTile; row <= last_row / kTile; ++row) {
        for (int column = first_column / kTile; column <= last_column / kTile; ++column) {
          if (tiles_[static_cast<std::size_t>(row * tile_columns + column)] != 0) return true;
        }
      }
      return false;
    };
    for (std::size_t i = 0; i + 2 < corners.size(); i += 3) {
      std::array<FieldPoint, 3> face = {points[corners[i]], points[corners[i + 1]],
                                        points[corners[i + 2]]};
      if (std::min({face[0].rho, face[1].rho, face[2].rho}) >= level_ || !touches(face)) continue;
      std::ranges::sort(face, {}, &FieldPoint::rho);
      const auto& [low, middle, high] = face;
      if (high.rho <= level_) {
        cover_triangle(low, middle, high, cut_gaps_);
        continue;
      }
      // rho is linear in the image of a flat face: so is the cut.
      const FieldPoint on_long = at_level(low, high, level_);
      if (middle.rho < level_) {
        cover_triangle(low, middle, on_long, cut_gaps_);
        cover_triangle(middle, at_level(middle, high, level_), on_long, cut_gaps_);
      } else {
        cover_triangle(low, at_level(low, middle, level_), on_long, cut_gaps_);
      }
    }
  }

  // Field value > 0 in cells with matter below the level that no disc round the outline found
  // reaches.
  void add_umbra(ShadowField& field) {
    transform_.start(window_.width, window_.height);
    for (const std::uint32_t i : outline_) {
      const auto stride = static_cast<std::ptrdiff_t>(window_.width);
      const std::array<std::ptrdiff_t, 8> steps = {
          -1, 1, -stride, stride, -stride - 1, -stride + 1, stride - 1, stride + 1};
      float rho = kInfinity;
      for (std::size_t direction = 0; direction < steps.size(); ++direction) {
        // Corners count only where no side is covered: they lie deeper inside.
        if (direction == 4 && rho < kInfinity) break;
        rho = std::min(rho, outline_rho(i, steps[direction]));
      }
      if (rho == kInfinity) continue;
      const int row = static_cast<int>(i) / window_.width;
      transform_.add(static_cast<int>(i) - row * window_.width, row, rho + gap(i));
    }
    transform_.run();
    for (int row = 0; row < window_.height; ++row) {
      merge_umbra(transform_.row(row), least_.data() + index_of(0, row), level_,
                  row_of(field, field.umbra, window_, row),
                  static_cast<std::size_t>(window_.width));
    }
  }

 private:
  // From centres to matter beside them along row and column [cells]; infinity where none is beside.
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
  // The cells of a window's row in a layer of the field.
  static float* row_of(const ShadowField& field, std::vector<float>& layer, const Window& window,
                       int row) {
    return layer.data() +
           static_cast<std::size_t>(row + window.bottom) * static_cast<std::size_t>(field.width) +
           static_cast<std::size_t>(window.left);
  }
  [[nodiscard]] bool covered(std::size_t index) const { return least_[index] < kInfinity; }

  template <class Use>
  void for_each_flagged(Use use) {
    const auto width = static_cast<std::size_t>(window_.width);
    for (std::size_t block = 0; block < width; block += sizeof(std::uint64_t)) {
      std::uint64_t flags = 0;  // of eight cells, few of which are flagged
      std::memcpy(&flags, flags_.data() + block, sizeof(flags));
      if (flags == 0) continue;
      for (std::size_t i = block; i < block + sizeof(flags); ++i) {
        if (flags_[i] != 0) use(i);
      }
    }
  }

  // rho of the matter that makes the outline between an uncovered cell and the next one in a
  // direction, or infinity. Where the lower surface rises towards the outline, as on a round body,
  // it is followed half a cell further, at most to where it meets the upper one. An outline that
  // the level makes is at the level.
  [[nodiscard]] float outline_rho(std::size_t uncovered, std::ptrdiff_t step) const {
    const std::size_t near = uncovered + static_cast<std::size_t>(step);
    if (!(least_[near] <= level_)) return kInfinity;
    if (covered(uncovered)) return least_[near];
    const std::size_t deep = near + static_cast<std::size_t>(step);
    if (!(least_[deep] <= level_)) return least_[near];
    const float rise = std::max(0.0F, least_[near] - least_[deep]);
    const float high_near = std::min(greatest_[near], level_);
    const float fall = std::max(0.0F, std::min(greatest_[deep], level_) - high_near);
    if (rise <= 0.0F) return least_[near];
    return least_[near] + rise * std::min(kHalfCell, (high_near - least_[near]) / (rise + fall));
  }

  void cover_triangle(FieldPoint a, FieldPoint b, FieldPoint c, Gaps& gaps) {
    if (b.y < a.y) std::swap(a, b);
    if (c.y < b.y) std::swap(b, c);
    if (b.y < a.y) std::swap(a, b);
    const auto bottom = static_cast<float>(window_.bottom);
    const auto left_edge = static_cast<float>(window_.left);
    // Corners lie inside the window by more than a cell: truncation rounds down.
    const int first_row = std::max(1, static_cast<int>(a.y - bottom + 0.5F));
    const int end_row = std::min(window_.height - 1, static_cast<int>(c.y - bottom + 0.5F));
    if (first_row >= end_row) return;
    const float area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if (area == 0.0F) return;
    // rho is linear in the image of a flat face.
    const float slope_x = ((b.rho - a.rho) * (c.y - a.y) - (c.rho - a.rho) * (b.y - a.y)) / area;
    const float slope_y = ((c.rho - a.rho) * (b.x - a.x) - (b.rho - a.rho) * (c.x - a.x)) / area;
    const float low = std::min(a.rho, std::min(b.rho, c.rho));
    const float high = std::max(a.rho, std::max(b.rho, c.rho));
    const auto slope = [](const FieldPoint& from, const FieldPoint& to) {
      const float rise = to.y - from.y;
      return rise > 0.0F ? (to.x - from.x) / rise : 0.0F;
    };
    const float slope_ac = slope(a, c);
    const float slope_ab = slope(a, b);
    const float slope_bc = slope(b, c);
    for (int row = first_row; row < end_row; ++row) {
      const float y = static_cast<float>(row) + 0.5F + bottom;
      const float across = a.x + (y - a.y) * slope_ac;
      const float other = y < b.y ? a.x + (y - a.y) * slope_ab : b.x + (y - b.y) * slope_bc;
      const int first = std::max(1, static_cast<int>(std::min(across, other) - left_edge + 0.5F));
      const int end =
          std::min(window_.width - 1, static_cast<int>(std::max(across, other) - left_edge + 0.5F));
      const std::size_t begin = index_of(0, row);
      const float at_row = a.rho + slope_y * (y - a.y) + slope_x * (left_edge + 0.5F - a.x);
      for (int column = first; column < end; ++column) {
        const float rho = std::clamp(at_row + slope_x * static_cast<float>(column), low, high);
        const std::size_t i = begin + static_cast<std::size_t>(column);
        greatest_[i] = std::max(greatest_[i], rho);
        least_[i] = std::min(least_[i], rho);
      }
      // How far matter begins from the centres beside the span, also where it covers none itself.
      const float left = std::min(across, other) - left_edge;
      const float right = std::max(across, other) - left_edge;
      float& before = gaps.x[begin + static_cast<std::size_t>(first - 1)];
      float& after = gaps.x[begin + static_cast<std::size_t>(end)];
      before = std::min(before, left - (static_cast<float>(first) - 0.5F));
      after = std::min(after, static_cast<float>(end) + 0.5F - right);
    }
    // The same along columns; here only the ends of the spans matter.
    if (b.x < a.x) std::swap(a, b);
    if (c.x < b.x) std::swap(b, c);
    if (b.x < a.x) std::swap(a, b);
    const int first_column = std::max(1, static_cast<int>(a.x - left_edge + 0.5F));
    const int end_column = std::min(window_.width - 1, static_cast<int>(c.x - left_edge + 0.5F));
    const auto tilt = [](const FieldPoint& from, const FieldPoint& to) {
      const float run = to.x - from.x;
      return run > 0.0F ? (to.y - from.y) / run : 0.0F;
    };
    const float tilt_ac = tilt(a, c);
    const float tilt_ab = tilt(a, b);
    const float tilt_bc = tilt(b, c);
    for (int column = first_column; column < end_column; ++column) {
      const float x = static_cast<float>(column) + 0.5F + left_edge;
      const float across = a.y + (x - a.x) * tilt_ac - bottom;
      const float other =
          (x < b.x ? a.y + (x - a.x) * tilt_ab : b.y + (x - b.x) * tilt_bc) - bottom;
      const float low_end = std::min(across, other);
      const float high_end = std::max(across, other);
      const int first = std::max(1, static_cast<int>(low_end + 0.5F));
      const int end = std::min(window_.height - 1, static_cast<int>(high_end + 0.5F));
      float& before = gaps.y[index_of(column, first - 1)];
      float& after = gaps.y[index_of(column, end)];
      before = std::min(before, low_end - (static_cast<float>(first) - 0.5F));
      after = std::min(after, static_cast<float>(end) + 0.5F - high_end);
    }
  }

  // Distance from the centre of an uncovered cell to the outline that passes beside it [cells];
  // half a cell where only a corner is near.
  [[nodiscard]] float gap(std::size_t i) const {
    float x = covered(i) ? kInfinity : gaps_.x[i];
    float y = covered(i) ? kInfinity : gaps_.y[i];
    if (level_ < kAllMatter) {
      x = std::min(x, cut_gaps_.x[i]);
      y = std::min(y, cut_gaps_.y[i]);
    }
    if (x < kInfinity && y < kInfinity) {
      const float sum = x * x + y * y;
      return sum > 0.0F ? x * y / std::sqrt(sum) : 0.0F;
    }
    const float one = std::min(x, y);
    return one < kInfinity ? one : kHalfCell;
  }

  static FieldPoint at_level(const FieldPoint& low, const FieldPoint& high, float level) {
    const float t = (level - low.rho) / (high.rho - low.rho);
    return {low.x + t * (high.x - low.x), low.y + t * (high.y - low.y), level};
  }

  Window window_;
  std::vector<float> greatest_, least_;  // rho per cell; -1 and infinity where not covered
  Gaps gaps_, cut_gaps_;
  float level_ = kAllMatter;            // of the outline
  std::vector<std::uint32_t> outline_;  // indices of cells
  static constexpr int kTile = 8;       // [cells]
  std::vector<std::uint8_t> tiles_;     // 1 where the outline runs over higher matter
  std::vector<float> middle_, column_least_;
  std::vector<std::uint8_t> flags_;
  PowerTransform transform_;
};

// Vertex and face lists of each part.
struct PartFaces {
  std::vector<std::uint32_t> begin;    // per part, into indices
  std::vector<std::uint32_t> indices;  // of vertices, three per face
};

PartFaces faces_by_part(std::span<const CasterVertex> vertices,
                        std::span<const std::uint32_t> indices, std::span<const std::uint32_t> part,
                        std::size_t part_count) {
  PartFaces faces;
  faces.begin.assign(part_count + 1, 0);
  const auto part_of = [&](std::size_t i) -> std::size_t {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      if (indices[i + corner] >= vertices.size() || indices[i + corner] >= part.size()) {
        return part_count;
      }
    }
    return std::min<std::size_t>(part[indices[i]], part_count);
  };
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    const std::size_t owner = part_of(i);
    if (owner < part_count) faces.begin[owner + 1] += 3;
  }
  std::partial_sum(faces.begin.begin(), faces.begin.end(), faces.begin.begin());
  faces.indices.resize(faces.begin.back());
  std::vector<std::uint32_t> fill(faces.begin.begin(), faces.begin.end() - 1);
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    const std::size_t owner = part_of(i);
    if (owner >= part_count) continue;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      faces.indices[fill[owner]++] = indices[i + corner];
    }
  }
  return faces;
}

struct HeightBounds {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();

  void add(float h) {
    low = std::min(low, static_cast<double>(h));
    high = std::max(high, static_cast<double>(h));
  }
};

struct Bounds {
  float left = kInfinity, bottom = kInfinity, right = -kInfinity, top = -kInfinity;

  void add(const FieldPoint& point, float radius) {
    left = std::min(left, point.x - radius);
    bottom = std::min(bottom, point.y - radius);
    right = std::max(right, point.x + radius);
    top = std::max(top, point.y + radius);
  }
  void add(const Bounds& other) {
    left = std::min(left, other.left);
    bottom = std::min(bottom, other.bottom);
    right = std::max(right, other.right);
    top = std::max(top, other.top);
  }
  [[nodiscard]] bool within(float size) const {
    return left > -size && bottom > -size && right < size && top < size;
  }
};

// Whether clipping to the range leaves a vertex alone. (Ends are left to the clipping, which knows
// how they round.)
bool is_within(const CasterVertex& vertex, const HeightRange& range) {
  return std::isfinite(vertex.u) && std::isfinite(vertex.v) && std::isfinite(vertex.ku) &&
         std::isfinite(vertex.kv) && static_cast<double>(vertex.h) >= range.low &&
         static_cast<double>(vertex.h) < std::min(range.high, 1e30);
}

// Which point a vertex became in the part at hand: a vertex may have faces in several.
class PartVertices {
 public:
  explicit PartVertices(std::size_t count) : point_(count), part_(count, 0) {}
  void start() { ++current_; }
  // The vertex's point, or the next one where it has none yet.
  std::pair<std::uint32_t, bool> find(std::uint32_t vertex, std::size_t next) {
    const bool is_new = part_[vertex] != current_;
    if (is_new) {
      part_[vertex] = current_;
      point_[vertex] = static_cast<std::uint32_t>(next);
    }
    return {point_[vertex], is_new};
  }

 private:
  std::vector<std::uint32_t> point_, part_;
  std::uint32_t current_ = 0;
};

// What a body that reaches under the plane covers of it: there is no light in the section, and no
// face of the body to say so. Triangles at height 0, three vertices each. Between two heights v of
// the section's corners no two sides cross, so the sides in order of u bound its trapezoids in
// pairs; where their number is odd the surface is open, and nothing is known of an inside.
std::vector<CasterVertex> section_of(std::span<const CasterVertex> vertices,
                                     std::span<const std::uint32_t> faces) {
  constexpr std::size_t kMostSides = 4000;
  struct Side {
    double u0, v0, u1, v1;  // v0 < v1
    [[nodiscard]] double u_at(double v) const { return u0 + (v - v0) / (v1 - v0) * (u1 - u0); }
  };
  std::vector<Side> sides;
  std::vector<double> levels;
  for (std::size_t i = 0; i + 2 < faces.size(); i += 3) {
    std::array<Eigen::Vector2d, 2> ends;
    std::size_t count = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      const CasterVertex& a = vertices[faces[i + k]];
      const CasterVertex& b = vertices[faces[i + (k + 1) % 3]];
      // A corner in the plane counts as above it.
      if ((a.h < 0.0F) == (b.h < 0.0F) || count == 2) continue;
      // The same for both faces of an edge.
      const bool turned = b.h < 0.0F;
      const CasterVertex& from = turned ? b : a;
      const CasterVertex& to = turned ? a : b;
      const double t =
          static_cast<double>(from.h) / (static_cast<double>(from.h) - static_cast<double>(to.h));
      const auto between = [t](float low, float high) {
        return static_cast<double>(low) +
               t * (static_cast<double>(high) - static_cast<double>(low));
      };
      ends[count++] = {between(from.u, to.u), between(from.v, to.v)};
    }
    if (count < 2 || !ends[0].allFinite() || !ends[1].allFinite()) continue;
    if (ends[0].y() == ends[1].y()) continue;
    const std::size_t low = ends[0].y() < ends[1].y() ? 0 : 1;
    sides.push_back({ends[low].x(), ends[low].y(), ends[1 - low].x(), ends[1 - low].y()});
    levels.insert(levels.end(), {ends[0].y(), ends[1].y()});
  }
  std::vector<CasterVertex> section;
  if (sides.size() > kMostSides) return section;
  std::ranges::sort(levels);
  levels.erase(std::unique(levels.begin(), levels.end()), levels.end());
  std::ranges::sort(sides, {}, &Side::v0);
  const auto corner = [](double u, double v) {
    const auto x = static_cast<float>(u);
    const auto y = static_cast<float>(v);
    return CasterVertex{x, y, 0.0F, x, y};
  };
  std::vector<const Side*> crossing;
  for (std::size_t i = 0; i + 1 < levels.size(); ++i) {
    const double low = levels[i];
    const double high = levels[i + 1];
    crossing.clear();
    for (const Side& side : sides) {
      if (side.v0 > low) break;
      if (side.v1 >= high) crossing.push_back(&side);
    }
    if (crossing.size() % 2 != 0) continue;
    const double middle = 0.5 * (low + high);
    std::ranges::sort(crossing, {}, [middle](const Side* side) { return side->u_at(middle); });
    for (std::size_t k = 0; k + 1 < crossing.size(); k += 2) {
      const CasterVertex a = corner(crossing[k]->u_at(low), low);
      const CasterVertex b = corner(crossing[k + 1]->u_at(low), low);
      const CasterVertex c = corner(crossing[k + 1]->u_at(high), high);
      const CasterVertex d = corner(crossing[k]->u_at(high), high);
      section.insert(section.end(), {a, b, c, a, c, d});
    }
  }
  return section;
}

// Projects clipped corners from the light of their part.
class LightProjection {
 public:
  LightProjection(const LayeredConstants& constants, const PartLight& light)
      : light_height_(constants.light_height),
        centre_(light.centre),
        radius_(std::isinf(constants.light_height) ? light.radius / constants.umbra_height
                                                   : light.radius * constants.light_ratio) {}

  [[nodiscard]] FieldPoint operator()(const CasterVertex& vertex) const {
    const double h = static_cast<double>(vertex.h);
    const double t = std::isinf(light_height_) ? 0.0 : h / (light_height_ - h);
    const double du = static_cast<double>(vertex.u) - centre_.x();
    const double dv = static_cast<double>(vertex.v) - centre_.y();
    return {static_cast<float>(static_cast<double>(vertex.u) + t * du),
            static_cast<float>(static_cast<double>(vertex.v) + t * dv),
            static_cast<float>(radius_ * (std::isinf(light_height_) ? h : t))};
  }
  // The light must not be at the zenith.
  [[nodiscard]] float rho_at(double h) const {
    return static_cast<float>(radius_ * (h / (light_height_ - h)));
  }

 private:
  double light_height_;
  Eigen::Vector2d centre_;
  double radius_;  // zenith: r_part / h_u, per metre of height; else a r_part, per t
};

}  // namespace

float ShadowField::sample(ShadowLayer which, const Eigen::Vector2d& p) const {
  const std::vector<float>& values = layer(which);
  const Eigen::Vector2d at = (p - origin) / cell - Eigen::Vector2d::Constant(0.5);
  const double column = std::floor(at.x());
  const double row = std::floor(at.y());
  if (!(column >= 0.0 && row >= 0.0 && column < width - 1 && row < height - 1)) return -1.0F;
  const std::size_t i = static_cast<std::size_t>(row) * static_cast<std::size_t>(width) +
                        static_cast<std::size_t>(column);
  const auto fx = static_cast<float>(at.x() - column);
  const auto fy = static_cast<float>(at.y() - row);
  const auto stride = static_cast<std::size_t>(width);
  const float low = values[i] + fx * (values[i + 1] - values[i]);
  const float high = values[i + stride] + fx * (values[i + stride + 1] - values[i + stride]);
  return low + fy * (high - low);
}

ShadowField power_distance_layers(std::span<const CasterVertex> vertices,
                                  std::span<const std::uint32_t> indices,
                                  std::span<const std::uint32_t> part,
                                  std::span<const PartLight> lights,
                                  const LayeredConstants& constants,
                                  const ShadowFieldOptions& options) {
  ShadowField field;
  const std::size_t part_count = lights.size();
  const PartFaces faces = faces_by_part(vertices, indices, part, part_count);
  const HeightRange range = layer_height_range(constants, ShadowLayer::middle);
  const bool zenith = std::isinf(constants.light_height);

  // Corners of all parts, first in metres.
  struct Job {
    std::size_t begin = 0, end = 0;  // into corners
    std::size_t first_point = 0;     // no job uses another's points
    Bounds matter, reach;
    // Heights below which matter has an umbra of its own, as rho; < 0: none. And whether there is
    // only an umbra to compute, of matter cut at such a height.
    std::array<float, kLevels.size()> levels = {-1.0F, -1.0F};
    float top = 0.0F;  // of all its matter, as rho
    bool cut = false;
  };
  std::vector<FieldPoint> points;
  std::vector<std::uint32_t> corners;  // indices into points, three per face
  std::vector<Job> jobs;
  Bounds all;
  points.reserve(vertices.size());
  corners.reserve(indices.size());
  const auto finish = [&](Job job) {
    job.end = corners.size();
    for (std::size_t i = job.first_point; i < points.size(); ++i) {
      job.matter.add(points[i], 0.0F);
      job.reach.add(points[i], points[i].rho);
    }
    // Nothing of this size casts on a table, and larger numbers would overflow.
    if (!job.reach.within(1e12F)) {
      corners.resize(job.begin);
      return;
    }
    all.add(job.reach);
    jobs.push_back(job);
  };
  PartVertices part_vertices(vertices.size());
  std::vector<std::uint32_t> straddling;
  for (std::size_t p = 0; p < part_count; ++p) {
    const auto part_faces =
        std::span(faces.indices).subspan(faces.begin[p], faces.begin[p + 1] - faces.begin[p]);
    if (part_faces.empty()) continue;
    const LightProjection project(constants, lights[p]);
    Job job;
    job.begin = corners.size();
    job.first_point = points.size();
    HeightBounds heights;
    straddling.clear();
    part_vertices.start();
    for (std::size_t i = 0; i < part_faces.size(); i += 3) {
      const auto face = part_faces.subspan(i, 3);
      bool whole = true;
      for (const std::uint32_t index : face) whole = whole && is_within(vertices[index], range);
      if (!whole) {
        straddling.insert(straddling.end(), face.begin(), face.end());
        continue;
      }
      for (const std::uint32_t index : face) {
        const auto [point, is_new] = part_vertices.find(index, points.size());
        if (is_new) {
          points.push_back(project(vertices[index]));
          heights.add(vertices[index].h);
        }
        corners.push_back(point);
      }
    }
    const std::vector<CasterVertex> section = section_of(vertices, straddling);
    const std::vector<CasterVertex> clipped = clip_to_heights(vertices, straddling, range);
    for (const std::vector<CasterVertex>* more : {&clipped, &section}) {
      for (const CasterVertex& corner : *more) {
        corners.push_back(static_cast<std::uint32_t>(points.size()));
        points.push_back(project(corner));
        heights.add(corner.h);
      }
    }
    if (corners.size() == job.begin) continue;
    // At the zenith all outlines are of one size, and so they are of flat matter.
    const bool levelled = !zenith && heights.high > heights.low;
    const auto top_of = [&heights](double level) {
      return heights.low + level * (heights.high - heights.low);
    };
    if (levelled && options.levels == FieldLevels::from_one_raster) {
      for (std::size_t i = 0; i < kLevels.size(); ++i)
        job.levels[i] = project.rho_at(top_of(kLevels[i]));
      job.top = project.rho_at(heights.high);
    }
    finish(job);
    if (!levelled || options.levels != FieldLevels::cut) continue;
    for (const double level : kLevels) {
      Job cut;
      cut.begin = corners.size();
      cut.first_point = points.size();
      cut.cut = true;
      const std::vector<CasterVertex> whole = clip_to_heights(vertices, part_faces, range);
      std::vector<std::uint32_t> order(whole.size());
      std::iota(order.begin(), order.end(), 0U);
      const std::vector<CasterVertex> below = clip_to_heights(whole, order, {0.0, top_of(level)});
      for (const std::vector<CasterVertex>* more : {&below, &section}) {
        for (const CasterVertex& corner : *more) {
          corners.push_back(static_cast<std::uint32_t>(points.size()));
          points.push_back(project(corner));
        }
      }
      if (corners.size() > cut.begin) finish(cut);
    }
  }
  const float extent = std::max(all.right - all.left, all.top - all.bottom);
  if (jobs.empty() || !(extent > 0.0F)) return field;

  constexpr int kMargin = 3;
  const float cell = std::max(extent / static_cast<float>(std::max(8, options.cells) - 2 * kMargin),
                              // Some cells it takes in any case.
                              std::min(static_cast<float>(options.finest_cell), extent / 24.0F));
  if (!(cell > std::numeric_limits<float>::min())) return field;
  field.cell = static_cast<double>(cell);
  field.width = static_cast<int>(std::ceil((all.right - all.left) / cell)) + 2 * kMargin;
  field.height = static_cast<int>(std::ceil((all.top - all.bottom) / cell)) + 2 * kMargin;
  const float left = all.left - static_cast<float>(kMargin) * cell;
  const float bottom = all.bottom - static_cast<float>(kMargin) * cell;
  field.origin = {static_cast<double>(left), static_cast<double>(bottom)};
  const std::size_t count =
      static_cast<std::size_t>(field.width) * static_cast<std::size_t>(field.height);
  field.umbra.assign(count, -1e6F);
  field.middle.assign(count, -1.0F);
  field.penumbra.assign(count, -1e6F);

  for (FieldPoint& point : points) {
    point = {(point.x - left) / cell, (point.y - bottom) / cell, point.rho / cell};
  }
  const auto window_of = [&](const Bounds& bounds) {
    const auto to_cells = [cell](float value, float from) {
      return static_cast<int>((value - from) / cell);
    };
    Window window;
    window.left = std::max(0, to_cells(bounds.left, left) - 2);
    window.bottom = std::max(0, to_cells(bounds.bottom, bottom) - 2);
    window.width = std::min(field.width, to_cells(bounds.right, left) + 4) - window.left;
    window.height = std::min(field.height, to_cells(bounds.top, bottom) + 4) - window.bottom;
    return window;
  };
  PartField part_field;
  for (const Job& job : jobs) {
    const auto faces_of_job = std::span(corners).subspan(job.begin, job.end - job.begin);
    part_field.cover(points, faces_of_job, window_of(job.matter));
    part_field.find_outline(kAllMatter);
    part_field.add_umbra(field);
    if (job.cut) continue;
    part_field.add_penumbra(window_of(job.reach), field);
    part_field.add_middle(field);
    float last = job.top / cell;
    for (const float level : job.levels) {
      const float rho = level / cell;
      // Matter as flat as that has one outline.
      constexpr float kFlat = 0.1F;  // [cells]
      if (level < 0.0F || last - rho < kFlat) continue;
      part_field.find_outline(rho);
      part_field.find_cut_gaps(points, faces_of_job);
      part_field.add_umbra(field);
      last = rho;
    }
  }
  return field;
}

namespace {

// Marching squares over the squares between four centres. A point on a side is computed from the
// side's lower end, so that neighbours share it.
struct FieldCorner {
  int column, row;
  float value;
};

PlanePoint field_point(const ShadowField& field, double column, double row) {
  return {static_cast<float>(field.origin.x() + field.cell * (column + 0.5)),
          static_cast<float>(field.origin.y() + field.cell * (row + 0.5))};
}

PlanePoint field_crossing(const ShadowField& field, FieldCorner a, FieldCorner b) {
  if (b.row < a.row || (b.row == a.row && b.column < a.column)) std::swap(a, b);
  const double t =
      static_cast<double>(a.value) / (static_cast<double>(a.value) - static_cast<double>(b.value));
  return field_point(field, a.column + t * (b.column - a.column), a.row + t * (b.row - a.row));
}

// In the order in which a square's sides turn to the left.
std::array<FieldCorner, 4> corners_of(const ShadowField& field, const std::vector<float>& values,
                                      int column, int row) {
  const auto stride = static_cast<std::size_t>(field.width);
  const std::size_t i = static_cast<std::size_t>(row) * stride + static_cast<std::size_t>(column);
  return {FieldCorner{column, row, values[i]}, FieldCorner{column + 1, row, values[i + 1]},
          FieldCorner{column + 1, row + 1, values[i + stride + 1]},
          FieldCorner{column, row + 1, values[i + stride]}};
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
      for (std::size_t c = 2; c < count; ++c) {
        triangles.insert(triangles.end(), {polygon[0], polygon[c - 1], polygon[c]});
      }
    }
  }
  return triangles;
}

namespace {

PENUMBRA_VECTOR_CLONES
void mark_inside(const float* values, std::size_t count, std::uint8_t* inside) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // two arrays
#endif
  for (std::size_t i = 0; i < count; ++i) inside[i] = values[i] > 0.0F ? 1 : 0;
}

// Of the squares between two rows, whether their corners differ; rows of one more than `count`.
PENUMBRA_VECTOR_CLONES
void mark_crossed(const std::uint8_t* low, const std::uint8_t* high, std::size_t count,
                  std::uint8_t* crossed) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // three arrays
#endif
  for (std::size_t i = 0; i < count; ++i) {
    crossed[i] = static_cast<std::uint8_t>((low[i] ^ low[i + 1]) | (low[i] ^ high[i]) |
                                           (low[i] ^ high[i + 1]));
  }
}

// What bounds a layer in one square. `ends`: which of its sides are the raster's border, where what
// is cut off ends.
void add_sides(const ShadowField& field, const std::array<FieldCorner, 4>& corners,
               const std::array<bool, 4>& ends, std::vector<OutlineSide>& sides) {
  // Where the sides of the square leave the inside, it is bounded up to where they come back.
  std::array<std::optional<PlanePoint>, 4> left;
  std::array<std::optional<PlanePoint>, 4> entered;
  for (std::size_t c = 0; c < 4; ++c) {
    const FieldCorner& from = corners[c];
    const FieldCorner& to = corners[(c + 1) % 4];
    const bool from_inside = from.value > 0.0F;
    const bool to_inside = to.value > 0.0F;
    if (from_inside != to_inside)
      (from_inside ? left : entered)[c] = field_crossing(field, from, to);
    if (!ends[c] || (!from_inside && !to_inside)) continue;
    sides.push_back({from_inside ? field_point(field, from.column, from.row) : entered[c].value(),
                     to_inside ? field_point(field, to.column, to.row) : left[c].value()});
  }
  for (std::size_t c = 0; c < 4; ++c) {
    if (!left[c]) continue;
    std::size_t back = (c + 1) % 4;
    while (!entered[back]) back = (back + 1) % 4;
    sides.push_back({*left[c], *entered[back]});
  }
}

}  // namespace

std::vector<OutlineSide> field_outline(const ShadowField& field, ShadowLayer layer) {
  std::vector<OutlineSide> sides;
  const std::vector<float>& values = field.layer(layer);
  if (field.width < 2 || field.height < 2) return sides;
  const auto width = static_cast<std::size_t>(field.width);
  const std::size_t squares = width - 1;  // in a row
  // Most of them lie wholly inside or outside: eight at once are looked over.
  constexpr std::size_t kAtOnce = sizeof(std::uint64_t);
  std::vector<std::uint8_t> low(width);
  std::vector<std::uint8_t> high(width);
  std::vector<std::uint8_t> worked_on((squares + kAtOnce - 1) / kAtOnce * kAtOnce);
  mark_inside(values.data(), width, high.data());
  for (int row = 0; row + 1 < field.height; ++row) {
    std::swap(low, high);
    mark_inside(values.data() + static_cast<std::size_t>(row + 1) * width, width, high.data());
    mark_crossed(low.data(), high.data(), squares, worked_on.data());
    const bool first_row = row == 0;
    const bool last_row = row + 2 == field.height;
    if (first_row || last_row) std::ranges::fill(worked_on, std::uint8_t{1});
    worked_on[0] = worked_on[squares - 1] = 1;
    for (std::size_t block = 0; block < squares; block += kAtOnce) {
      std::uint64_t flags = 0;
      std::memcpy(&flags, worked_on.data() + block, sizeof(flags));
      if (flags == 0) continue;
      for (std::size_t i = block; i < std::min(block + kAtOnce, squares); ++i) {
        if (worked_on[i] == 0) continue;
        const auto column = static_cast<int>(i);
        add_sides(field, corners_of(field, values, column, row),
                  {first_row, i + 1 == squares, last_row, i == 0}, sides);
      }
    }
  }
  return sides;
}

}  // namespace penumbra
