#include "render/shadow/kernels/shadow_kernels.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <numeric>
#include <span>

#include "core/assert.hpp"
#include "core/vector_clones.hpp"
#include "render/model/to_eigen.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/shadow/kernels/footprint.hpp"
#include "render/shadow/kernels/kernel_tuning.hpp"

namespace penumbra {

namespace {

// Relaxed local thickness (docs/shadows.md#kernels); its constants are in kernel_tuning.hpp.
constexpr double kHoleShare = 0.005;  // smaller holes are missing faces
// Bodies that an author made one part are measured as one across joints of this share of the
// silhouette's shorter side: else each brick would have the thickness of a brick.
constexpr double kJointShare = 0.05;
constexpr int kCentroidCells = 128;  // along each side
constexpr int kMedianFiner = 2;  // a part's median radius is worth twice the cells along each side
// However small they would be, a part's median radius has so many cells.
constexpr int kFewestMedianCells = 32 * 32;
constexpr int kTileCells = 8;
constexpr std::size_t kFewVertices = 64;  // then tiles cost more than they spare
// A radius is known to half a cell, so a disc may reach that much further, times the reach: in
// cells of a raster whose longer side has the nominal number of cells.
constexpr float kRadiusSlack = 0.5F;
constexpr float kBorderSlack = 1.0F;  // the same for a vertex that no disc reaches
// Rounding must not choose between the two sides of what is symmetric: a disc that just reaches a
// point does, and squared distances in radii that differ by no more are equal.
constexpr float kReachRounding = 1e-3F;  // [cells]
constexpr float kAsNear = 1.001F;
constexpr float kNearEnough = 1e-6F;

// One of d and -d, the same for both: a silhouette seen from behind has the same kernels.
Eigen::Vector3d canonical_direction(const Eigen::Vector3d& up) {
  const Eigen::Vector3d d = up.normalized();
  const bool flip = d.z() < 0.0 || (d.z() == 0.0 && (d.y() < 0.0 || (d.y() == 0.0 && d.x() < 0.0)));
  return flip ? Eigen::Vector3d(-d) : d;
}

// A kernel in the plane of the silhouette.
struct PlanarKernel {
  Eigen::Vector2f centre = Eigen::Vector2f::Zero();
  float radius = 0.0F;
};

// How many of the cells that are left a disc holds; they are left no more.
PENUMBRA_VECTOR_CLONES
std::int32_t take_held(const float* x, const float* y, std::int32_t* left, std::size_t count,
                       float disc_x, float disc_y, float squared_reach) {
  std::int32_t held = 0;
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // three arrays
#endif
  for (std::size_t i = 0; i < count; ++i) {
    const float dx = disc_x - x[i];
    const float dy = disc_y - y[i];
    const std::int32_t now = dx * dx + dy * dy <= squared_reach ? left[i] : 0;
    held += now;
    left[i] -= now;
  }
  return held;
}

// The depth of ridge cells, 0 elsewhere, and whether they are: of `count` cells, rows of `stride`
// cells one after another. There are a row and a cell before and after them.
PENUMBRA_VECTOR_CLONES
void find_ridge(const float* depths, std::ptrdiff_t stride, std::size_t count, float slope,
                float* ridge, std::uint8_t* flags) {
  const float diagonal_slope = slope * 1.41421356F;
  const float* above = depths - stride;
  const float* below = depths + stride;
  const float* left = depths - 1;
  const float* right = depths + 1;
  const float* above_left = above - 1;
  const float* above_right = above + 1;
  const float* below_left = below - 1;
  const float* below_right = below + 1;
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // different arrays
#endif
  for (std::size_t x = 0; x < count; ++x) {
    const float beside = left[x] > right[x] ? left[x] : right[x];
    const float upright = above[x] > below[x] ? above[x] : below[x];
    const float straight = beside > upright ? beside : upright;
    const float over = above_left[x] > above_right[x] ? above_left[x] : above_right[x];
    const float under = below_left[x] > below_right[x] ? below_left[x] : below_right[x];
    const float diagonal = over > under ? over : under;
    const float depth = depths[x];
    const bool on_ridge =
        (depth > 0.0F) & (depth + slope > straight) & (depth + diagonal_slope > diagonal);
    ridge[x] = on_ridge ? depth : 0.0F;
    flags[x] = on_ridge ? 1 : 0;
  }
}

// Discs that are asked for the one that reaches a point, many at once.
constexpr std::size_t kDiscBlock = 16;
// The first block from `block` on in which a disc reaches the point, and `blocks` where none does.
PENUMBRA_VECTOR_CLONES
std::size_t first_reaching_block(const float* x, const float* y, const float* squared_reach,
                                 std::size_t block, std::size_t blocks, float to_x, float to_y) {
  for (; block < blocks; ++block) {
    std::int32_t reached = 0;
    for (std::size_t i = block * kDiscBlock; i < (block + 1) * kDiscBlock; ++i) {
      const float dx = x[i] - to_x;
      const float dy = y[i] - to_y;
      reached |= dx * dx + dy * dy <= squared_reach[i] ? 1 : 0;
    }
    if (reached != 0) break;
  }
  return block;
}

// How far each of the discs' centres is from a point, squared, in radii of the disc and as bits,
// which sort as they do: infinity where the disc does not reach the point. The least of them.
PENUMBRA_VECTOR_CLONES
std::int32_t relative_distances(const float* x, const float* y, const float* squared_reach,
                                const float* squared_radius, std::size_t count, float to_x,
                                float to_y, std::int32_t* distances) {
  std::int32_t least = std::bit_cast<std::int32_t>(std::numeric_limits<float>::infinity());
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // different arrays
#endif
  for (std::size_t i = 0; i < count; ++i) {
    const float dx = x[i] - to_x;
    const float dy = y[i] - to_y;
    const float squared = dx * dx + dy * dy;
    const float in_radii = squared / squared_radius[i];
    const auto distance = std::bit_cast<std::int32_t>(
        squared <= squared_reach[i] ? in_radii : std::numeric_limits<float>::infinity());
    distances[i] = distance;
    least = distance < least ? distance : least;
  }
  return least;
}

struct Disc {
  float x, y, radius;  // [cells]
};

// Discs, each with how far it reaches [cells].
class ReachingDiscs {
 public:
  void clear() { discs_.clear(); }
  void add(const Disc& disc) { discs_.push_back(disc); }
  // Once all are there: they reach `times` their radius and `slack` further.
  void set_reach(float times, float slack) {
    const std::size_t padded = (discs_.size() + kDiscBlock - 1) / kDiscBlock * kDiscBlock;
    x_.resize(padded);
    y_.resize(padded);
    squared_reach_.resize(padded);
    squared_radius_.resize(padded);
    distances_.resize(padded);
    for (std::size_t i = 0; i < discs_.size(); ++i) {
      const float reach = times * discs_[i].radius + slack;
      x_[i] = discs_[i].x;
      y_[i] = discs_[i].y;
      squared_reach_[i] = reach * reach;
      squared_radius_[i] = discs_[i].radius * discs_[i].radius;
    }
    for (std::size_t i = discs_.size(); i < padded; ++i) {
      x_[i] = y_[i] = 0.0F;
      squared_reach_[i] = -1.0F;
      squared_radius_[i] = 1.0F;
    }
  }
  [[nodiscard]] const std::vector<Disc>& all() const { return discs_; }
  [[nodiscard]] bool reaches(std::size_t disc, float x, float y) const {
    const float dx = x_[disc] - x;
    const float dy = y_[disc] - y;
    return dx * dx + dy * dy <= squared_reach_[disc];
  }
  // The first from `disc` on that reaches the point; all().size() where none does.
  [[nodiscard]] std::size_t next_reaching(std::size_t disc, float x, float y) const {
    for (; disc < discs_.size() && disc % kDiscBlock != 0; ++disc) {
      if (reaches(disc, x, y)) return disc;
    }
    if (disc >= discs_.size()) return discs_.size();
    const std::size_t block = first_reaching_block(x_.data(), y_.data(), squared_reach_.data(),
                                                   disc / kDiscBlock, x_.size() / kDiscBlock, x, y);
    disc = block * kDiscBlock;
    while (disc < discs_.size() && !reaches(disc, x, y)) ++disc;
    return std::min(disc, discs_.size());
  }
  // Of those from `first` to before `end` that reach the point, as the first does: the one whose
  // centre is nearest in its own radii; of equally near ones the first.
  [[nodiscard]] std::size_t nearest(std::size_t first, std::size_t end, float x, float y) {
    const std::int32_t least =
        relative_distances(x_.data() + first, y_.data() + first, squared_reach_.data() + first,
                           squared_radius_.data() + first, end - first, x, y, distances_.data());
    const float limit = std::bit_cast<float>(least) * kAsNear + kNearEnough;
    const auto found =
        std::find_if(distances_.begin(), distances_.end(),
                     [limit](std::int32_t bits) { return std::bit_cast<float>(bits) <= limit; });
    return first + static_cast<std::size_t>(found - distances_.begin());
  }

 private:
  std::vector<Disc> discs_;
  // Whole blocks; those at the end reach nothing.
  std::vector<float> x_, y_, squared_reach_, squared_radius_;
  std::vector<std::int32_t> distances_;
};

// By which of the nine cells around a ridge cell, itself among them, are the same ridge: where that
// ridge's middle is from there, and how much deeper. Bits from the lower left, row by row.
struct RidgeMiddle {
  float x = 0.0F, y = 0.0F, deeper = 0.0F;  // [cells]
};
const std::array<RidgeMiddle, 512>& ridge_middles() {
  static const std::array<RidgeMiddle, 512> table = [] {
    std::array<RidgeMiddle, 512> middles;
    for (unsigned cells = 1; cells < middles.size(); ++cells) {
      RidgeMiddle& middle = middles[cells];
      for (unsigned cell = 0; cell < 9; ++cell) {
        if ((cells >> cell & 1U) == 0) continue;
        middle.x += static_cast<float>(cell % 3) - 1.0F;
        middle.y += static_cast<float>(cell / 3) - 1.0F;
      }
      const auto count = static_cast<float>(std::popcount(cells));
      middle.x /= count;
      middle.y /= count;
      middle.deeper = std::sqrt(middle.x * middle.x + middle.y * middle.y);
    }
    return middles;
  }();
  return table;
}

// Cells of a silhouette, each until a disc holds it.
struct CellSamples {
  std::vector<float> x, y;         // of the centres [cells]
  std::vector<std::int32_t> left;  // 1, or 0 once held

  void clear() {
    x.clear();
    y.clear();
    left.clear();
  }
  void add(float column, float row) {
    x.push_back(column);
    y.push_back(row);
    left.push_back(1);
  }
  // How many of those that are left the disc holds.
  std::size_t take(float disc_x, float disc_y, float squared_reach) {
    return static_cast<std::size_t>(
        take_held(x.data(), y.data(), left.data(), x.size(), disc_x, disc_y, squared_reach));
  }
};

// The positions and faces of one part, contiguous.
struct PartGeometry {
  std::span<const Eigen::Vector2f> points;  // [m], from the part's reference point
  std::span<const std::uint32_t> faces;     // indices into points
  bool joined = false;                      // of several bodies, with joints between them
};

// Of the points' bounds along the axes; 0 of none.
template <class Points>
Eigen::Vector2f extent_of(const Points& points) {
  if (points.empty()) return Eigen::Vector2f::Zero();
  auto low = points[0];
  auto high = points[0];
  for (const auto& point : points) {
    low = low.cwiseMin(point);
    high = high.cwiseMax(point);
  }
  return (high - low).template cast<float>();
}

// Kernels of one part after another; keeps its buffers.
class LocalThickness {
 public:
  // `parts`: how many there are to be measured.
  explicit LocalThickness(bool smooth, std::size_t parts, KernelProgress* progress = nullptr,
                          const KernelTuning& tuning = {})
      : smooth_(smooth), progress_(progress), tuning_(tuning) {
    const double share = static_cast<double>(tuning.cells_of_all) /
                         static_cast<double>(std::max<std::size_t>(1, parts));
    least_side_cells_ = std::clamp(static_cast<int>(std::sqrt(share)), tuning.least_side_cells,
                                   std::max(tuning.least_side_cells, tuning.most_side_cells));
  }

  void generate(const PartGeometry& part, std::span<PlanarKernel> kernels) {
    for (std::size_t i = 0; i < kernels.size(); ++i) kernels[i] = {part.points[i], 0.0F};
    const int side = side_cells(part);
    if (!rasterise(part, side, side * side)) {
      if (progress_ != nullptr) progress_->done += part.points.size();
      return;
    }
    if (part.points.size() <= kFewVertices) {
      std::swap(near_, discs_);
      near_.set_reach(tuning_.reach, kRadiusSlack * tuning_.reach * nominal_cell_ + kReachRounding);
      for (std::size_t i = 0; i < part.points.size(); ++i) {
        assign(raster_.to_cells(part.points[i]), kernels[i]);
      }
      if (progress_ != nullptr) progress_->done += part.points.size();
      return;
    }
    sort_vertices_into_tiles(part.points);
    for (std::size_t tile = 0; tile + 1 < tile_begin_.size(); ++tile) {
      const std::size_t begin = tile_begin_[tile];
      const std::size_t end = tile_begin_[tile + 1];
      if (begin == end) continue;
      gather_near_discs(tile);
      for (std::size_t i = begin; i < end; ++i) {
        const std::uint32_t vertex = tile_vertices_[i];
        assign(points_[vertex], kernels[vertex]);
      }
      if (progress_ != nullptr) progress_->done += end - begin;
    }
  }

  // The covered cells of the part's silhouette with a kernel each, and the size of a cell [m].
  struct CellKernel {
    Eigen::Vector2f place;
    PlanarKernel kernel;
  };
  float sample(const PartGeometry& part, float finest_cell, std::vector<CellKernel>& samples) {
    samples.clear();
    const Eigen::Vector2f extent = extent_of(part.points);
    const float of_use = (extent.x() / finest_cell) * (extent.y() / finest_cell);
    if (!rasterise(part, side_cells(part), std::clamp(static_cast<int>(of_use), 64, 512 * 512))) {
      return 0.0F;
    }
    std::vector<Eigen::Vector2f> places;
    for (int row = 0; row < raster_.height(); ++row) {
      const float* cells = raster_.covered_row(row);
      for (int column = 0; column < raster_.width(); ++column) {
        if (cells[column] == 0.0F) continue;
        places.push_back(raster_.from_cells(
            {static_cast<float>(column) + 0.5F, static_cast<float>(row) + 0.5F}));
      }
    }
    samples.resize(places.size());
    sort_vertices_into_tiles(places);
    for (std::size_t tile = 0; tile + 1 < tile_begin_.size(); ++tile) {
      if (tile_begin_[tile] == tile_begin_[tile + 1]) continue;
      gather_near_discs(tile);
      for (std::size_t i = tile_begin_[tile]; i < tile_begin_[tile + 1]; ++i) {
        const std::uint32_t place = tile_vertices_[i];
        samples[place] = {places[place], {places[place], 0.0F}};
        assign(points_[place], samples[place].kernel);
      }
    }
    return raster_.cell();
  }

  // Centroid of the part's silhouette, and the median of the radii that its cells are assigned; in
  // cells of no less than `finest_cell` [m].
  PlanarKernel median(const PartGeometry& part, float finest_cell) {
    PlanarKernel result;
    const int side = side_cells(part);
    const Eigen::Vector2f extent = extent_of(part.points);
    const int most = kMedianFiner * kMedianFiner * side * side;
    const float of_use = extent.x() * extent.y() / (finest_cell * finest_cell);
    const int budget = of_use < static_cast<float>(most)
                           ? std::max(kFewestMedianCells, static_cast<int>(of_use))
                           : most;
    if (!rasterise(part, side, budget)) {
      for (const Eigen::Vector2f& point : part.points) result.centre += point;
      if (!part.points.empty()) result.centre /= static_cast<float>(part.points.size());
      return result;
    }
    result.centre = raster_.centroid();
    // Some 500 cells say the median to a cell's accuracy.
    constexpr std::size_t kSamples = 500;
    const std::size_t step = std::max<std::size_t>(1, raster_.covered_count() / kSamples);
    std::size_t covered = 0;
    samples_.clear();
    for (int row = 0; row < raster_.height(); ++row) {
      const float* cells = raster_.covered_row(row);
      for (int column = 0; column < raster_.width(); ++column) {
        if (cells[column] == 0.0F || covered++ % step != 0) continue;
        samples_.add(static_cast<float>(column) + 0.5F, static_cast<float>(row) + 0.5F);
      }
    }
    // A cell's thickness is the radius of the largest disc that holds it: from the largest disc on,
    // the median is the one with which half of the cells are held.
    std::size_t left = samples_.x.size() - samples_.x.size() / 2;
    for (const Disc& disc : discs_.all()) {
      const float reach = disc.radius + 0.5F;
      const std::size_t held = samples_.take(disc.x, disc.y, reach * reach);
      if (held < left) {
        left -= held;
        continue;
      }
      result.radius = disc.radius * raster_.cell();
      break;
    }
    return result;
  }

 private:
  [[nodiscard]] int side_cells(const PartGeometry& part) const {
    return std::clamp(
        static_cast<int>(std::lround(tuning_.cells_per_root *
                                     std::sqrt(static_cast<double>(part.points.size())))),
        least_side_cells_, std::max(least_side_cells_, tuning_.most_side_cells));
  }

  // Raster, depth and discs of a part; false where it has none.
  bool rasterise(const PartGeometry& part, int side, int cell_budget) {
    if (part.faces.empty() || !raster_.cover(part.points, part.faces, cell_budget)) return false;
    if (part.joined) {
      const int shorter = std::min(raster_.width(), raster_.height());
      raster_.bridge_gaps(std::max(1, static_cast<int>(kJointShare * shorter)));
    }
    raster_.fill_small_holes(kHoleShare);
    raster_.compute_depth();
    nominal_cell_ =
        static_cast<float>(std::max(raster_.width(), raster_.height())) / static_cast<float>(side);
    find_discs();
    return !discs_.all().empty();
  }

  void find_discs() {
    const std::size_t stride = raster_.stride();
    const auto height = static_cast<std::size_t>(raster_.height());
    ridge_.resize(stride * height);
    ridge_flags_.resize(stride * height);
    // The margin has none.
    const std::size_t first = stride + 1;
    const std::size_t last = stride * (height - 1) - 1;
    std::fill_n(ridge_.begin(), first, 0.0F);
    std::fill_n(ridge_flags_.begin(), first, std::uint8_t{0});
    find_ridge(raster_.depth_row(0) + first, static_cast<std::ptrdiff_t>(stride), last - first,
               tuning_.ridge_slope, ridge_.data() + first, ridge_flags_.data() + first);
    std::fill(ridge_.begin() + static_cast<std::ptrdiff_t>(last), ridge_.end(), 0.0F);
    std::fill(ridge_flags_.begin() + static_cast<std::ptrdiff_t>(last), ridge_flags_.end(),
              std::uint8_t{0});
    found_.clear();
    for (std::size_t row = 1; row + 1 < height; ++row) {
      for (std::size_t block = 0; block < stride; block += sizeof(std::uint64_t)) {
        std::uint64_t eight = 0;  // flags, few of which are set
        std::memcpy(&eight, ridge_flags_.data() + row * stride + block, sizeof(eight));
        if (eight == 0) continue;
        for (std::size_t i = block; i < block + sizeof(eight); ++i) {
          if (ridge_flags_[row * stride + i] != 0) add_disc(i, row);
        }
      }
    }
    sort_discs();
  }

  // The disc of a ridge cell.
  void add_disc(std::size_t column, std::size_t row) {
    // A ridge between two rows of cells shows in both: its middle is the mean of what is
    // equally deep around. Without this a kernel lies half a cell off.
    const float* ridge = ridge_.data() + (row - 1) * raster_.stride() + column - 1;
    const float depth = ridge[raster_.stride() + 1];
    unsigned same = 0;
    for (unsigned y = 0; y < 3; ++y) {
      for (unsigned x = 0; x < 3; ++x) {
        const float off = ridge[y * raster_.stride() + x] - depth;
        same |= static_cast<unsigned>(std::abs(off) <= tuning_.ridge_slope) << (3 * y + x);
      }
    }
    const RidgeMiddle& middle = ridge_middles_[same];
    // The outline runs half a cell before the nearest centre outside; a centre moved to the
    // middle of the ridge is that much deeper.
    found_.push_back({static_cast<float>(column) + 0.5F + middle.x,
                      static_cast<float>(row) + 0.5F + middle.y, depth - 0.5F + middle.deeper});
  }

  // Largest first, equal ones in the order of the raster: into buckets by radius, and each of those
  // sorted. Radii are positive: their bits sort as they do.
  void sort_discs() {
    discs_.clear();
    if (found_.empty()) return;
    float largest = 0.0F;
    for (const Disc& disc : found_) largest = std::max(largest, disc.radius);
    constexpr std::size_t kBuckets = 128;
    const float scale = (static_cast<float>(kBuckets) - 1.0F) / largest;
    const auto bucket_of = [scale](float radius) {
      return kBuckets - 1 - std::min(static_cast<std::size_t>(radius * scale), kBuckets - 1);
    };
    std::array<std::uint32_t, kBuckets + 1> end{};
    for (const Disc& disc : found_) ++end[bucket_of(disc.radius) + 1];
    std::partial_sum(end.begin(), end.end(), end.begin());
    disc_keys_.resize(found_.size());
    for (std::size_t i = 0; i < found_.size(); ++i) {
      disc_keys_[end[bucket_of(found_[i].radius)]++] =
          (static_cast<std::uint64_t>(~std::bit_cast<std::uint32_t>(found_[i].radius)) << 32U) | i;
    }
    auto begin = disc_keys_.begin();
    for (std::size_t bucket = 0; bucket < kBuckets; ++bucket) {
      const auto bucket_end = disc_keys_.begin() + static_cast<std::ptrdiff_t>(end[bucket]);
      if (!std::is_sorted(begin, bucket_end)) std::sort(begin, bucket_end);
      begin = bucket_end;
    }
    for (const std::uint64_t key : disc_keys_) discs_.add(found_[key & 0xffffffffU]);
  }

  void sort_vertices_into_tiles(std::span<const Eigen::Vector2f> points) {
    // Half a tile's diagonal, and the cell by which a border vertex may lie outside.
    discs_.set_reach(tuning_.reach, 0.5F * kTileCells * 1.41421356F + kBorderSlack * nominal_cell_);
    tile_columns_ = (raster_.width() + kTileCells - 1) / kTileCells;
    const int tile_rows = (raster_.height() + kTileCells - 1) / kTileCells;
    points_.resize(points.size());
    vertex_tile_.resize(points.size());
    tile_begin_.assign(static_cast<std::size_t>(tile_columns_ * tile_rows) + 1, 0);
    for (std::size_t i = 0; i < points.size(); ++i) {
      points_[i] = raster_.to_cells(points[i]);
      const int column =
          std::clamp(static_cast<int>(points_[i].x()) / kTileCells, 0, tile_columns_ - 1);
      const int row = std::clamp(static_cast<int>(points_[i].y()) / kTileCells, 0, tile_rows - 1);
      vertex_tile_[i] = static_cast<std::uint32_t>(row * tile_columns_ + column);
      ++tile_begin_[vertex_tile_[i] + 1];
    }
    std::partial_sum(tile_begin_.begin(), tile_begin_.end(), tile_begin_.begin());
    tile_vertices_.resize(points.size());
    tile_fill_.assign(tile_begin_.begin(), tile_begin_.end() - 1);
    for (std::uint32_t i = 0; i < points.size(); ++i) {
      tile_vertices_[tile_fill_[vertex_tile_[i]]++] = i;
    }
  }

  // The discs that may reach a vertex of the tile, in order of their radius.
  void gather_near_discs(std::size_t tile) {
    const int row = static_cast<int>(tile) / tile_columns_;
    const int column = static_cast<int>(tile) % tile_columns_;
    const float x = (static_cast<float>(column) + 0.5F) * kTileCells;
    const float y = (static_cast<float>(row) + 0.5F) * kTileCells;
    near_.clear();
    for (std::size_t disc = discs_.next_reaching(0, x, y); disc < discs_.all().size();
         disc = discs_.next_reaching(disc + 1, x, y)) {
      near_.add(discs_.all()[disc]);
    }
    near_.set_reach(tuning_.reach, kRadiusSlack * tuning_.reach * nominal_cell_ + kReachRounding);
  }

  void assign(const Eigen::Vector2f& p, PlanarKernel& kernel) {
    const std::vector<Disc>& discs = near_.all();
    const std::size_t largest = near_.next_reaching(0, p.x(), p.y());
    const Disc* winner = nullptr;
    if (largest < discs.size()) {
      const float limit = tuning_.equal_radius * discs[largest].radius;
      const auto end = std::partition_point(  // largest first
          discs.begin() + static_cast<std::ptrdiff_t>(largest) + 1, discs.end(),
          [limit](const Disc& disc) { return disc.radius >= limit; });
      winner = &discs[near_.nearest(largest, static_cast<std::size_t>(end - discs.begin()), p.x(),
                                    p.y())];
    } else {
      // A border vertex between cells: the disc that misses it by least.
      float least = kBorderSlack * nominal_cell_;
      for (const Disc& other : discs) {
        const float miss =
            std::hypot(other.x - p.x(), other.y - p.y()) - tuning_.reach * other.radius;
        if (miss >= least) continue;
        least = miss;
        winner = &other;
      }
    }
    if (winner == nullptr) return;
    Disc chosen = *winner;
    if (smooth_) blend(p, chosen);
    kernel.centre = raster_.from_cells({chosen.x, chosen.y});
    kernel.radius = chosen.radius * raster_.cell();
  }

  // Mean of all discs that reach p, weighted r^8 (1 - |p - c|^2 / (reach r)^2)^2.
  void blend(const Eigen::Vector2f& p, Disc& chosen) const {
    float x = 0.0F;
    float y = 0.0F;
    float radius = 0.0F;
    float sum = 0.0F;
    for (const Disc& disc : near_.all()) {
      const float dx = disc.x - p.x();
      const float dy = disc.y - p.y();
      const float inside =
          1.0F - (dx * dx + dy * dy) / (tuning_.reach * tuning_.reach * disc.radius * disc.radius);
      if (inside <= 0.0F) continue;
      const float relative = disc.radius / chosen.radius;
      const float squared = relative * relative;
      const float weight = squared * squared * squared * squared * inside * inside;
      x += weight * disc.x;
      y += weight * disc.y;
      radius += weight * disc.radius;
      sum += weight;
    }
    if (sum <= 0.0F) return;
    chosen = {x / sum, y / sum, radius / sum};
  }

  bool smooth_;
  KernelProgress* progress_;
  int least_side_cells_ = 0;
  KernelTuning tuning_;
  float nominal_cell_ = 1.0F;  // [cells]
  FootprintRaster raster_;
  std::vector<float> ridge_;  // depth of ridge cells, else 0
  CellSamples samples_;
  std::vector<std::uint8_t> ridge_flags_;  // which those are
  const std::array<RidgeMiddle, 512>& ridge_middles_ = ridge_middles();
  std::vector<Disc> found_;     // in the order of the raster
  ReachingDiscs discs_, near_;  // largest first; near_: those that may reach a tile's vertices
  std::vector<std::uint64_t> disc_keys_;
  std::vector<Eigen::Vector2f> points_;  // [cells]
  std::vector<std::uint32_t> vertex_tile_, tile_begin_, tile_fill_, tile_vertices_;
  int tile_columns_ = 0;
};

// The positions of all parts one after another, projected along a direction.
struct PartList {
  std::vector<std::uint32_t> position_begin, face_begin;  // part_count + 1
  std::vector<std::uint32_t> positions;                   // mesh position of each point
  std::vector<Eigen::Vector2f> points;                    // from the part's first point
  std::vector<std::uint32_t> faces;  // indices into the part's points, three per face
};

PartList split_into_parts(const ShadowMesh& mesh, const std::vector<Eigen::Vector2d>& projected) {
  PartList list;
  const std::size_t count = mesh.positions.size();
  list.position_begin.assign(mesh.part_count + 1, 0);
  for (const std::uint32_t part : mesh.part) ++list.position_begin[part + 1];
  std::partial_sum(list.position_begin.begin(), list.position_begin.end(),
                   list.position_begin.begin());
  std::vector<std::uint32_t> fill(list.position_begin.begin(), list.position_begin.end() - 1);
  std::vector<std::uint32_t> local(count);
  list.positions.resize(count);
  list.points.resize(count);
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::uint32_t part = mesh.part[i];
    const std::uint32_t place = fill[part]++;
    local[i] = place - list.position_begin[part];
    list.positions[place] = i;
    list.points[place] =
        (projected[i] - projected[list.positions[list.position_begin[part]]]).cast<float>();
  }
  list.face_begin.assign(mesh.part_count + 1, 0);
  for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
    list.face_begin[mesh.part[mesh.indices[i]] + 1] += 3;
  }
  std::partial_sum(list.face_begin.begin(), list.face_begin.end(), list.face_begin.begin());
  fill.assign(list.face_begin.begin(), list.face_begin.end() - 1);
  list.faces.resize(mesh.indices.size());
  for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
    std::uint32_t& place = fill[mesh.part[mesh.indices[i]]];
    for (std::size_t corner = 0; corner < 3; ++corner) {
      list.faces[place++] = local[mesh.indices[i + corner]];
    }
  }
  return list;
}

std::vector<Eigen::Vector2d> project_along(const ShadowMesh& mesh, const PlaneFrame& view) {
  std::vector<Eigen::Vector2d> projected;
  projected.reserve(mesh.positions.size());
  for (const glm::vec3& p : mesh.positions) {
    projected.push_back(view.to_plane(to_eigen(p)).head<2>());
  }
  return projected;
}

PartGeometry geometry_of(const PartList& parts, const ShadowMesh& mesh, std::size_t part) {
  return {std::span(parts.points)
              .subspan(parts.position_begin[part],
                       parts.position_begin[part + 1] - parts.position_begin[part]),
          std::span(parts.faces)
              .subspan(parts.face_begin[part], parts.face_begin[part + 1] - parts.face_begin[part]),
          !mesh.joined.empty() && mesh.joined[part]};
}

ShadowKernels generate_for_direction(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                     KernelSource source, KernelProgress* progress,
                                     const KernelTuning& tuning = {}) {
  ShadowKernels result;
  result.up = up.normalized();
  const PlaneFrame view = PlaneFrame::make(canonical_direction(up), Eigen::Vector3d::Zero());
  const std::size_t count = mesh.positions.size();
  const std::vector<Eigen::Vector2d> projected = project_along(mesh, view);

  result.kernels.resize(count);
  const auto set_kernel = [&](std::size_t i, const Eigen::Vector2d& to_kernel) {
    const Eigen::Vector3d k =
        to_eigen(mesh.positions[i]) + to_kernel.x() * view.e1 + to_kernel.y() * view.e2;
    // Coordinates at the end of float's range overflow; such a vertex stays where it is.
    const auto fits = [](double x) { return std::abs(x) <= std::numeric_limits<float>::max(); };
    result.kernels[i] = fits(k.x()) && fits(k.y()) && fits(k.z())
                            ? glm::vec3(static_cast<float>(k.x()), static_cast<float>(k.y()),
                                        static_cast<float>(k.z()))
                            : mesh.positions[i];
  };

  if (source == KernelSource::centroid) {
    std::vector<Eigen::Vector2f> points(count);
    for (std::size_t i = 0; i < count; ++i) points[i] = (projected[i] - projected[0]).cast<float>();
    FootprintRaster raster;
    if (!raster.cover(points, mesh.indices, kCentroidCells * kCentroidCells)) {
      result.kernels = mesh.positions;
      return result;
    }
    const Eigen::Vector2d centre = projected[0] + raster.centroid().cast<double>();
    for (std::size_t i = 0; i < count; ++i) set_kernel(i, centre - projected[i]);
    return result;
  }

  const PartList parts = split_into_parts(mesh, projected);
  LocalThickness thickness(source == KernelSource::smooth, mesh.part_count, progress, tuning);
  std::vector<PlanarKernel> kernels(count);
  for (std::size_t part = 0; part < mesh.part_count; ++part) {
    const PartGeometry geometry = geometry_of(parts, mesh, part);
    thickness.generate(
        geometry, std::span(kernels).subspan(parts.position_begin[part], geometry.points.size()));
  }
  result.radius.resize(count);
  for (std::size_t place = 0; place < count; ++place) {
    const std::uint32_t i = parts.positions[place];
    set_kernel(i, (kernels[place].centre - parts.points[place]).cast<double>());
    result.radius[i] = kernels[place].radius;
  }
  return result;
}

// Layered Penumbrae, section 5.3, in the exact form of docs/shadows.md#kernel-directions: k = sum
// of d_i^2 k_i over the sets k_i made for up = axis i. Exact on the axes only.
ShadowKernels compose_per_axis(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                               KernelProgress* progress) {
  const Eigen::Vector3d d = up.normalized();
  ShadowKernels result;
  result.up = d;
  std::vector<Eigen::Vector3d> sum(mesh.positions.size(), Eigen::Vector3d::Zero());
  result.radius.assign(mesh.positions.size(), 0.0F);
  for (int axis = 0; axis < 3; ++axis) {
    const double weight = d[axis] * d[axis];
    if (weight <= 0.0) continue;
    const ShadowKernels set = generate_for_direction(mesh, Eigen::Vector3d::Unit(axis),
                                                     KernelSource::automatic, progress);
    for (std::size_t i = 0; i < sum.size(); ++i) {
      sum[i] += weight * to_eigen(set.kernels[i]);
      result.radius[i] += static_cast<float>(weight) * set.radius[i];
    }
  }
  result.kernels.reserve(sum.size());
  for (const Eigen::Vector3d& k : sum) {
    result.kernels.emplace_back(static_cast<float>(k.x()), static_cast<float>(k.y()),
                                static_cast<float>(k.z()));
  }
  return result;
}

}  // namespace

ShadowKernels generate_kernels(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                               KernelSource source, KernelProgress* progress) {
  PENUMBRA_ASSERT(up.allFinite() && up.squaredNorm() > 0.0);
  const bool per_axis = source == KernelSource::per_axis;
  if (progress != nullptr) {
    const auto sets = per_axis ? static_cast<std::size_t>((up.array() != 0.0).count()) : 1U;
    progress->total = sets * mesh.positions.size();
  }
  ShadowKernels kernels = per_axis ? compose_per_axis(mesh, up, progress)
                                   : generate_for_direction(mesh, up, source, progress);
  if (progress != nullptr) progress->done = progress->total.load();
  return kernels;
}

ShadowKernels generate_tuned_kernels(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                     const KernelTuning& tuning) {
  PENUMBRA_ASSERT(up.allFinite() && up.squaredNorm() > 0.0);
  return generate_for_direction(mesh, up, KernelSource::automatic, nullptr, tuning);
}

std::vector<PartDisc> part_discs(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                 double finest_cell, bool across_joints) {
  PENUMBRA_ASSERT(up.allFinite() && up.squaredNorm() > 0.0);
  const PlaneFrame view = PlaneFrame::make(canonical_direction(up), Eigen::Vector3d::Zero());
  const std::vector<Eigen::Vector2d> projected = project_along(mesh, view);
  const PartList parts = split_into_parts(mesh, projected);
  LocalThickness thickness(false, mesh.part_count);
  const float finest_cell_m = static_cast<float>(finest_cell) * extent_of(projected).maxCoeff();
  std::vector<PartDisc> discs(mesh.part_count);
  for (std::size_t part = 0; part < mesh.part_count; ++part) {
    PartGeometry geometry = geometry_of(parts, mesh, part);
    geometry.joined = geometry.joined && across_joints;
    const PlanarKernel disc = thickness.median(geometry, finest_cell_m);
    const std::uint32_t first = parts.positions[parts.position_begin[part]];
    const Eigen::Vector3d centre = to_eigen(mesh.positions[first]) +
                                   static_cast<double>(disc.centre.x()) * view.e1 +
                                   static_cast<double>(disc.centre.y()) * view.e2;
    discs[part] = {glm::vec3(static_cast<float>(centre.x()), static_cast<float>(centre.y()),
                             static_cast<float>(centre.z())),
                   disc.radius};
  }
  return discs;
}

std::vector<SilhouettePoint> silhouette_points(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                               int cells) {
  PENUMBRA_ASSERT(up.allFinite() && up.squaredNorm() > 0.0 && cells > 0);
  const PlaneFrame view = PlaneFrame::make(canonical_direction(up), Eigen::Vector3d::Zero());
  const std::vector<Eigen::Vector2d> projected = project_along(mesh, view);
  const PartList parts = split_into_parts(mesh, projected);
  LocalThickness thickness(false, mesh.part_count);
  const float finest_cell_m = extent_of(projected).maxCoeff() / static_cast<float>(cells);
  std::vector<SilhouettePoint> points;
  if (!(finest_cell_m > 0.0F) || !std::isfinite(finest_cell_m)) return points;
  std::vector<LocalThickness::CellKernel> samples;
  for (std::size_t part = 0; part < mesh.part_count; ++part) {
    const float side = thickness.sample(geometry_of(parts, mesh, part), finest_cell_m, samples);
    const Eigen::Vector3d first =
        to_eigen(mesh.positions[parts.positions[parts.position_begin[part]]]);
    const auto in_object = [&](const Eigen::Vector2f& p) {
      const Eigen::Vector3d q =
          first + static_cast<double>(p.x()) * view.e1 + static_cast<double>(p.y()) * view.e2;
      return glm::vec3(static_cast<float>(q.x()), static_cast<float>(q.y()),
                       static_cast<float>(q.z()));
    };
    for (const LocalThickness::CellKernel& sample : samples) {
      points.push_back({in_object(sample.place), in_object(sample.kernel.centre), side});
    }
  }
  return points;
}

}  // namespace penumbra
