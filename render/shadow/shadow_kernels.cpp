#include "render/shadow/shadow_kernels.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <span>

#include "core/assert.hpp"
#include "core/vector_clones.hpp"
#include "render/shadow/footprint.hpp"
#include "render/shadow/plane_frame.hpp"

namespace penumbra {

namespace {

// Relaxed local thickness (shadows.md 2.6): a vertex belongs to the largest disc inside its part's
// silhouette that reaches it when grown by kReach. At least sqrt(2): the corners of a square then
// share its centre, so that a cube scales as a cube.
//
// What follows is either what a raster can tell, or the middle of a plateau: of 400 shapes made at
// random (stars, ribbons, tiles, round bodies, limbs; none of them a test's), whose layers were
// compared with ray casting.
constexpr float kReach = 1.5F;
// Discs this close to the largest count as equally large; of those the one that is nearest, in its
// own radii, wins. Agreement is the same from 0.93 to 0.96, and worse by 0.002 at 0.97 and by 0.02
// at 1.
constexpr float kEqualRadius = 0.95F;
// A cell whose depth grows by less than this share of the distance to any neighbour is on a ridge:
// of less than 45 degrees. The same from 0.6 to 0.8.
constexpr float kRidgeSlope = 0.7F;
// Neighbours of a ridge cell that are less deep by no more than that are the same ridge, seen in
// two rows of cells.
constexpr float kSameDepth = kRidgeSlope;  // [cells]
constexpr double kHoleShare = 0.005;       // smaller holes are missing faces
constexpr int kMinSideCells = 32;
constexpr int kMaxSideCells = 128;
constexpr int kMedianFiner = 2;  // a part's median radius is worth twice the cells along each side
// However small they would be, a part's median radius has so many cells.
constexpr int kFewestMedianCells = 32 * 32;
constexpr int kTileCells = 8;
constexpr std::size_t kFewVertices = 64;  // then tiles cost more than they spare
// A radius is known to half a cell, so a disc may reach that much further: in cells of a raster
// whose longer side has the nominal number of cells.
constexpr float kReachSlack = 0.5F * kReach;
constexpr float kBorderSlack = 1.0F;  // the same for a vertex that no disc reaches

// One of d and -d, the same for both: a silhouette seen from behind has the same kernels.
Eigen::Vector3d canonical_direction(const Eigen::Vector3d& up) {
  const Eigen::Vector3d d = up.normalized();
  const bool flip = d.z() < 0.0 || (d.z() == 0.0 && (d.y() < 0.0 || (d.y() == 0.0 && d.x() < 0.0)));
  return flip ? Eigen::Vector3d(-d) : d;
}

Eigen::Vector3d to_eigen(const glm::vec3& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
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

// The depth of ridge cells of a row, 0 elsewhere, and whether they are: for x in [1, width - 1).
PENUMBRA_VECTOR_CLONES
void find_ridge(const float* above, const float* here, const float* below, std::size_t width,
                float* ridge, std::uint8_t* flags) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // different arrays
#endif
  for (std::size_t x = 1; x + 1 < width; ++x) {
    const float beside = here[x - 1] > here[x + 1] ? here[x - 1] : here[x + 1];
    const float upright = above[x] > below[x] ? above[x] : below[x];
    const float straight = beside > upright ? beside : upright;
    const float over = above[x - 1] > above[x + 1] ? above[x - 1] : above[x + 1];
    const float under = below[x - 1] > below[x + 1] ? below[x - 1] : below[x + 1];
    const float diagonal = over > under ? over : under;
    const float depth = here[x];
    const bool on_ridge = (depth > 0.0F) & (depth + kRidgeSlope > straight) &
                          (depth + kRidgeSlope * 1.41421356F > diagonal);
    ridge[x] = on_ridge ? depth : 0.0F;
    flags[x] = on_ridge ? 1 : 0;
  }
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
  explicit LocalThickness(bool smooth, KernelProgress* progress = nullptr)
      : smooth_(smooth), progress_(progress) {}

  void generate(const PartGeometry& part, std::span<PlanarKernel> kernels) {
    for (std::size_t i = 0; i < kernels.size(); ++i) kernels[i] = {part.points[i], 0.0F};
    const int side = side_cells(part);
    if (!rasterise(part, side, side * side)) {
      if (progress_ != nullptr) progress_->done += part.points.size();
      return;
    }
    if (part.points.size() <= kFewVertices) {
      near_.swap(discs_);
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
    for (const Disc& disc : discs_) {
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
  struct Disc {
    float x, y, radius;  // [cells]
  };

  // Agreement is the same with 6 to 12 times the root.
  static int side_cells(const PartGeometry& part) {
    return std::clamp(
        static_cast<int>(std::lround(8.0 * std::sqrt(static_cast<double>(part.points.size())))),
        kMinSideCells, kMaxSideCells);
  }

  // Raster, depth and discs of a part; false where it has none.
  bool rasterise(const PartGeometry& part, int side, int cell_budget) {
    if (part.faces.empty() || !raster_.cover(part.points, part.faces, cell_budget)) return false;
    raster_.fill_small_holes(kHoleShare);
    raster_.compute_depth();
    nominal_cell_ =
        static_cast<float>(std::max(raster_.width(), raster_.height())) / static_cast<float>(side);
    find_discs();
    return !discs_.empty();
  }

  void find_discs() {
    const auto width = static_cast<std::ptrdiff_t>(raster_.width());
    ridge_.assign(static_cast<std::size_t>(width) * static_cast<std::size_t>(raster_.height()),
                  0.0F);
    // Whole blocks of eight for each row; the border is never flagged.
    const std::size_t flag_stride = (static_cast<std::size_t>(width) + 7) / 8 * 8;
    ridge_flags_.assign(flag_stride * static_cast<std::size_t>(raster_.height()), 0);
    for (int row = 1; row + 1 < raster_.height(); ++row) {
      find_ridge(raster_.depth_row(row - 1), raster_.depth_row(row), raster_.depth_row(row + 1),
                 static_cast<std::size_t>(width), ridge_.data() + row * width,
                 ridge_flags_.data() + static_cast<std::size_t>(row) * flag_stride);
    }
    discs_.clear();
    for (int row = 1; row + 1 < raster_.height(); ++row) {
      const float* ridge = ridge_.data() + row * width;
      const std::uint8_t* flags = ridge_flags_.data() + static_cast<std::size_t>(row) * flag_stride;
      for (std::size_t block = 0; block < flag_stride; block += sizeof(std::uint64_t)) {
        std::uint64_t eight = 0;  // flags, few of which are set
        std::memcpy(&eight, flags + block, sizeof(eight));
        if (eight == 0) continue;
        for (std::size_t i = block; i < block + sizeof(eight); ++i) {
          if (flags[i] != 0) add_disc(ridge, static_cast<std::ptrdiff_t>(i), row);
        }
      }
    }
    sort_discs();
  }

  // The disc of a ridge cell.
  void add_disc(const float* ridge, std::ptrdiff_t column, int row) {
    const auto width = static_cast<std::ptrdiff_t>(raster_.width());
    const float depth = ridge[column];
    // A ridge between two rows of cells shows in both: its middle is the mean of what is
    // equally deep around. Without this a kernel lies half a cell off.
    float x = 0.0F;
    float y = 0.0F;
    float count = 0.0F;
    for (std::ptrdiff_t dy = -1; dy <= 1; ++dy) {
      for (std::ptrdiff_t dx = -1; dx <= 1; ++dx) {
        if (std::abs(ridge[dy * width + column + dx] - depth) > kSameDepth) continue;
        x += static_cast<float>(dx);
        y += static_cast<float>(dy);
        count += 1.0F;
      }
    }
    x /= count;
    y /= count;
    // The outline runs half a cell before the nearest centre outside; a centre moved to the
    // middle of the ridge is that much deeper.
    discs_.push_back({static_cast<float>(column) + 0.5F + x, static_cast<float>(row) + 0.5F + y,
                      depth - 0.5F + std::sqrt(x * x + y * y)});
  }

  // Largest first, equal ones in the order of the raster. Radii are positive: their bits sort as
  // they do.
  void sort_discs() {
    disc_keys_.resize(discs_.size());
    for (std::size_t i = 0; i < discs_.size(); ++i) {
      disc_keys_[i] =
          (static_cast<std::uint64_t>(~std::bit_cast<std::uint32_t>(discs_[i].radius)) << 32U) | i;
    }
    std::sort(disc_keys_.begin(), disc_keys_.end());
    near_.resize(discs_.size());
    for (std::size_t i = 0; i < discs_.size(); ++i) near_[i] = discs_[disc_keys_[i] & 0xffffffffU];
    discs_.swap(near_);
  }

  void sort_vertices_into_tiles(std::span<const Eigen::Vector2f> points) {
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
    // Half a tile's diagonal, and the cell by which a border vertex may lie outside.
    const float slack = 0.5F * kTileCells * 1.41421356F + kBorderSlack * nominal_cell_;
    near_.clear();
    for (const Disc& disc : discs_) {
      const float dx = disc.x - x;
      const float dy = disc.y - y;
      const float reach = kReach * disc.radius + slack;
      if (dx * dx + dy * dy <= reach * reach) near_.push_back(disc);
    }
  }

  void assign(const Eigen::Vector2f& p, PlanarKernel& kernel) const {
    const Disc* winner = nullptr;
    float winner_distance = 0.0F;  // squared, in radii
    float limit = 0.0F;
    const float slack = kReachSlack * nominal_cell_;
    for (const Disc& disc : near_) {
      if (winner != nullptr && disc.radius < limit) break;
      const float dx = disc.x - p.x();
      const float dy = disc.y - p.y();
      const float squared = dx * dx + dy * dy;
      const float reach = kReach * disc.radius + slack;
      if (squared > reach * reach) continue;
      const float distance = squared / (disc.radius * disc.radius);
      if (winner == nullptr) limit = kEqualRadius * disc.radius;
      if (winner == nullptr || distance < winner_distance) {
        winner = &disc;
        winner_distance = distance;
      }
    }
    if (winner == nullptr) {
      // A border vertex between cells: the disc that misses it by least.
      float least = kBorderSlack * nominal_cell_;
      for (const Disc& disc : near_) {
        const float miss = std::hypot(disc.x - p.x(), disc.y - p.y()) - kReach * disc.radius;
        if (miss >= least) continue;
        least = miss;
        winner = &disc;
      }
    }
    if (winner == nullptr) return;
    Disc chosen = *winner;
    if (smooth_) blend(p, chosen);
    kernel.centre = raster_.from_cells({chosen.x, chosen.y});
    kernel.radius = chosen.radius * raster_.cell();
  }

  // Mean of all discs that reach p, weighted r^8 (1 - |p - c|^2 / (kReach r)^2)^2.
  void blend(const Eigen::Vector2f& p, Disc& chosen) const {
    float x = 0.0F;
    float y = 0.0F;
    float radius = 0.0F;
    float sum = 0.0F;
    for (const Disc& disc : near_) {
      const float dx = disc.x - p.x();
      const float dy = disc.y - p.y();
      const float inside =
          1.0F - (dx * dx + dy * dy) / (kReach * kReach * disc.radius * disc.radius);
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
  float nominal_cell_ = 1.0F;  // [cells]
  FootprintRaster raster_;
  std::vector<float> ridge_;  // depth of ridge cells, else 0
  CellSamples samples_;
  std::vector<std::uint8_t> ridge_flags_;  // which those are
  std::vector<Disc> discs_, near_;
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

PartGeometry geometry_of(const PartList& parts, std::size_t part) {
  return {
      std::span(parts.points)
          .subspan(parts.position_begin[part],
                   parts.position_begin[part + 1] - parts.position_begin[part]),
      std::span(parts.faces)
          .subspan(parts.face_begin[part], parts.face_begin[part + 1] - parts.face_begin[part])};
}

ShadowKernels generate_for_direction(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                     KernelSource source, KernelProgress* progress) {
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
    if (!raster.cover(points, mesh.indices, kMaxSideCells * kMaxSideCells)) {
      result.kernels = mesh.positions;
      return result;
    }
    const Eigen::Vector2d centre = projected[0] + raster.centroid().cast<double>();
    for (std::size_t i = 0; i < count; ++i) set_kernel(i, centre - projected[i]);
    return result;
  }

  const PartList parts = split_into_parts(mesh, projected);
  LocalThickness thickness(source == KernelSource::smooth, progress);
  std::vector<PlanarKernel> kernels(count);
  for (std::size_t part = 0; part < mesh.part_count; ++part) {
    const PartGeometry geometry = geometry_of(parts, part);
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

// Layered Penumbrae, section 5.3, in the exact form of shadows.md 2.7: k = sum of d_i^2 k_i over
// the sets k_i made for up = axis i. Exact on the axes only.
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

std::vector<PartDisc> part_discs(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                 double finest_cell) {
  PENUMBRA_ASSERT(up.allFinite() && up.squaredNorm() > 0.0);
  const PlaneFrame view = PlaneFrame::make(canonical_direction(up), Eigen::Vector3d::Zero());
  const std::vector<Eigen::Vector2d> projected = project_along(mesh, view);
  const PartList parts = split_into_parts(mesh, projected);
  LocalThickness thickness(false);
  const float finest_cell_m = static_cast<float>(finest_cell) * extent_of(projected).maxCoeff();
  std::vector<PartDisc> discs(mesh.part_count);
  for (std::size_t part = 0; part < mesh.part_count; ++part) {
    const PlanarKernel disc = thickness.median(geometry_of(parts, part), finest_cell_m);
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
  LocalThickness thickness(false);
  const float finest_cell_m = extent_of(projected).maxCoeff() / static_cast<float>(cells);
  std::vector<SilhouettePoint> points;
  if (!(finest_cell_m > 0.0F) || !std::isfinite(finest_cell_m)) return points;
  std::vector<LocalThickness::CellKernel> samples;
  for (std::size_t part = 0; part < mesh.part_count; ++part) {
    const float side = thickness.sample(geometry_of(parts, part), finest_cell_m, samples);
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
