#include "render/shadow/kernels/shadow_kernels.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>

#include "core/assert.hpp"
#include "core/vector_clones.hpp"
#include "render/model/to_eigen.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/shadow/casters/index_groups.hpp"
#include "render/shadow/kernels/footprint.hpp"
#include "render/shadow/kernels/silhouette_discs.hpp"

namespace penumbra {

namespace {

// Relaxed local thickness (docs/shadows.md#kernels); its other constants are in KernelTuning.
constexpr double kHoleShare = 0.005;  // fraction of covered cells; smaller holes are missing faces
// The thickness of bodies that a group joins is measured across joints of up to this fraction of
// the silhouette's shorter side. Otherwise a wall would be as thick as one brick.
constexpr double kJointShare = 0.05;
constexpr int kCentroidCells = 128;  // along each side
constexpr int kMedianFiner = 2;  // refinement of the raster for a median radius, along each side
constexpr int kMinMedianCells = 32 * 32;  // cells for the median radius of a small part
constexpr int kTileCells = 8;
constexpr std::size_t kFewVertices = 64;  // below this, tiles cost more than they save
// Tolerances in nominal cells, the cells of a raster whose longer side has the nominal number of
// cells: for a radius, and for vertices that no disc reaches.
constexpr float kRadiusSlack = 0.5F;
constexpr float kBorderSlack = 1.0F;
constexpr float kReachRounding = 1e-3F;  // tolerance for a disc that just reaches a point [cells]

// Returns d or -d, the same for both, because opposite views have the same silhouette and kernels.
Eigen::Vector3d canonical_direction(const Eigen::Vector3d& up) {
  const Eigen::Vector3d d = up.normalized();
  const bool flip = d.z() < 0.0 || (d.z() == 0.0 && (d.y() < 0.0 || (d.y() == 0.0 && d.x() < 0.0)));
  return flip ? Eigen::Vector3d(-d) : d;
}

// A kernel in the silhouette's plane.
struct PlanarKernel {
  Eigen::Vector2f centre = Eigen::Vector2f::Zero();
  float radius = 0.0F;
};

// Clears remaining[i] for cells that the disc reaches; returns the number of cleared cells.
PENUMBRA_VECTOR_CLONES
std::int32_t clear_reached(const float* x, const float* y, std::int32_t* __restrict remaining,
                           std::size_t count, float disc_x, float disc_y, float squared_reach) {
  std::int32_t cleared = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const float dx = disc_x - x[i];
    const float dy = disc_y - y[i];
    const std::int32_t hit = dx * dx + dy * dy <= squared_reach ? remaining[i] : 0;
    cleared += hit;
    remaining[i] -= hit;
  }
  return cleared;
}

// Sampled cells of a silhouette that are not yet in a disc.
struct CellSamples {
  std::vector<float> x, y;         // centres [cells]
  std::vector<std::int32_t> left;  // 1, or 0 once in a disc

  void clear() {
    x.clear();
    y.clear();
    left.clear();
  }
  void add(const Eigen::Vector2f& centre) {
    x.push_back(centre.x());
    y.push_back(centre.y());
    left.push_back(1);
  }
};

struct PartGeometry {
  std::span<const Eigen::Vector2f> points;  // [m], relative to the part's first point
  std::span<const std::uint32_t> faces;     // indices into points
  bool joined = false;                      // several bodies with joints between them
};

// Returns the size of the points' bounds; 0 without points.
template <class Point>
Eigen::Vector2f extent_of(std::span<const Point> points) {
  if (points.empty()) return Eigen::Vector2f::Zero();
  Eigen::AlignedBox<typename Point::Scalar, 2> box;
  for (const Point& point : points) box.extend(point);
  return box.sizes().template cast<float>();
}

// Computes the kernels of one part after another; reuses its memory.
class LocalThickness {
 public:
  // `parts`: number of parts to be measured.
  LocalThickness(bool smooth, std::size_t parts, KernelProgress* progress = nullptr,
                 const KernelTuning& tuning = {})
      : smooth_(smooth), progress_(progress), tuning_(tuning) {
    const double share = static_cast<double>(tuning.shared_cells) /
                         static_cast<double>(std::max<std::size_t>(1, parts));
    min_side_cells_ = std::clamp(static_cast<int>(std::sqrt(share)), tuning.min_side_cells,
                                 std::max(tuning.min_side_cells, tuning.max_side_cells));
  }

  void generate(const PartGeometry& part, std::span<PlanarKernel> kernels) {
    const int side = side_cells(part);
    if (!rasterise(part, side, side * side)) {
      for (std::size_t i = 0; i < kernels.size(); ++i) kernels[i] = {part.points[i], 0.0F};
      report(part.points.size());
    } else if (part.points.size() > kFewVertices) {
      assign_by_tiles(part.points, kernels);
    } else {
      std::swap(near_, discs_);
      set_near_reach();
      for (std::size_t i = 0; i < part.points.size(); ++i)
        kernels[i] = kernel_at(part.points[i], raster_.to_cells(part.points[i]));
      report(part.points.size());
    }
  }

  // Writes the covered cells of the part's silhouette and their kernels; returns the cell size [m].
  float sample(const PartGeometry& part, float finest_cell, std::vector<Eigen::Vector2f>& positions,
               std::vector<PlanarKernel>& kernels) {
    positions.clear();
    kernels.clear();
    const Eigen::Vector2f extent = extent_of(part.points);
    const float useful = (extent.x() / finest_cell) * (extent.y() / finest_cell);
    if (!rasterise(part, side_cells(part), std::clamp(static_cast<int>(useful), 64, 512 * 512)))
      return 0.0F;
    for_each_covered(
        [&](const Eigen::Vector2f& centre) { positions.push_back(raster_.from_cells(centre)); });
    kernels.resize(positions.size());
    assign_by_tiles(positions, kernels);
    return raster_.cell();
  }

  // Returns the centroid of the part's silhouette and the median radius over its cells.
  // `finest_cell`: minimum cell size [m].
  PlanarKernel median(const PartGeometry& part, float finest_cell) {
    PlanarKernel result;
    const int side = side_cells(part);
    const Eigen::Vector2f extent = extent_of(part.points);
    const int max_budget = kMedianFiner * kMedianFiner * side * side;
    const float useful_cells = extent.x() * extent.y() / (finest_cell * finest_cell);
    const int budget = useful_cells < static_cast<float>(max_budget)
                           ? std::max(kMinMedianCells, static_cast<int>(useful_cells))
                           : max_budget;
    if (!rasterise(part, side, budget)) {
      for (const Eigen::Vector2f& point : part.points) result.centre += point;
      if (!part.points.empty()) result.centre /= static_cast<float>(part.points.size());
      return result;
    }
    result.centre = raster_.centroid();
    constexpr std::size_t kSamples = 500;  // enough for a median accurate to one cell
    const std::size_t step = std::max<std::size_t>(1, raster_.covered_count() / kSamples);
    std::size_t covered = 0;
    samples_.clear();
    for_each_covered([&](const Eigen::Vector2f& centre) {
      if (covered++ % step == 0) samples_.add(centre);
    });
    // A cell's thickness is the radius of the largest disc that contains it. In descending order of
    // radius, the median is the radius of the disc that completes half of the cells.
    const std::size_t count = samples_.x.size();
    std::size_t missing = count - count / 2;
    for (const Disc& disc : discs_.all()) {
      const float reach = disc.radius + 0.5F;
      const auto contained = static_cast<std::size_t>(
          clear_reached(samples_.x.data(), samples_.y.data(), samples_.left.data(), count, disc.x,
                        disc.y, reach * reach));
      if (contained < missing) {
        missing -= contained;
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
        min_side_cells_, std::max(min_side_cells_, tuning_.max_side_cells));
  }

  void report(std::size_t vertices) {
    if (progress_ != nullptr) progress_->done += vertices;
  }

  // Computes a part's raster, depth and discs; returns false if the part has no discs.
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
    ridge_.find(raster_, tuning_.ridge_slope, discs_);
    return !discs_.all().empty();
  }

  // Calls use(centre [cells]) for each covered cell, row by row.
  template <class Use>
  void for_each_covered(const Use& use) const {
    for (int row = 0; row < raster_.height(); ++row) {
      const float* cells = raster_.covered_row(row);
      for (int column = 0; column < raster_.width(); ++column) {
        if (cells[column] == 0.0F) continue;
        use(Eigen::Vector2f(static_cast<float>(column) + 0.5F, static_cast<float>(row) + 0.5F));
      }
    }
  }

  void set_near_reach() {
    near_.set_reach(tuning_.reach, kRadiusSlack * tuning_.reach * nominal_cell_ + kReachRounding);
  }

  void assign_by_tiles(std::span<const Eigen::Vector2f> points, std::span<PlanarKernel> kernels) {
    // Half a tile's diagonal, plus the cell by which a border vertex may lie outside.
    discs_.set_reach(tuning_.reach, 0.5F * kTileCells * 1.41421356F + kBorderSlack * nominal_cell_);
    const int columns = (raster_.width() + kTileCells - 1) / kTileCells;
    const int rows = (raster_.height() + kTileCells - 1) / kTileCells;
    points_.resize(points.size());
    tile_of_.resize(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      points_[i] = raster_.to_cells(points[i]);
      const int column = std::clamp(static_cast<int>(points_[i].x()) / kTileCells, 0, columns - 1);
      const int row = std::clamp(static_cast<int>(points_[i].y()) / kTileCells, 0, rows - 1);
      tile_of_[i] = static_cast<std::uint32_t>(row * columns + column);
    }
    tiles_.sort(points.size(), static_cast<std::size_t>(columns * rows),
                [this](std::size_t i) { return tile_of_[i]; });
    for (int tile = 0; tile < columns * rows; ++tile) {
      const std::span<const std::uint32_t> vertices = tiles_[static_cast<std::size_t>(tile)];
      if (vertices.empty()) continue;
      gather_near_discs((static_cast<float>(tile % columns) + 0.5F) * kTileCells,
                        (static_cast<float>(tile / columns) + 0.5F) * kTileCells);
      for (const std::uint32_t i : vertices) kernels[i] = kernel_at(points[i], points_[i]);
      report(vertices.size());
    }
  }

  // Gathers the discs that may reach a vertex of the tile around a point, in order of their radius.
  void gather_near_discs(float x, float y) {
    near_.clear();
    for (std::size_t disc = discs_.next_reaching(0, x, y); disc < discs_.all().size();
         disc = discs_.next_reaching(disc + 1, x, y)) {
      near_.add(discs_.all()[disc]);
    }
    set_near_reach();
  }

  // `cell`: the point in cells of the raster.
  [[nodiscard]] PlanarKernel kernel_at(const Eigen::Vector2f& point, const Eigen::Vector2f& cell) {
    const std::vector<Disc>& discs = near_.all();
    const std::size_t largest = near_.next_reaching(0, cell.x(), cell.y());
    const Disc* winner = nullptr;
    if (largest < discs.size()) {
      const float limit = tuning_.equal_radius * discs[largest].radius;
      const auto end = std::partition_point(  // largest first
          discs.begin() + static_cast<std::ptrdiff_t>(largest) + 1, discs.end(),
          [limit](const Disc& disc) { return disc.radius >= limit; });
      winner = &discs[near_.nearest(largest, static_cast<std::size_t>(end - discs.begin()),
                                    cell.x(), cell.y())];
    } else {
      // For a border vertex that no disc reaches, uses the disc with the smallest distance to it.
      float min_miss = kBorderSlack * nominal_cell_;
      for (const Disc& disc : discs) {
        const float miss =
            std::hypot(disc.x - cell.x(), disc.y - cell.y()) - tuning_.reach * disc.radius;
        if (miss >= min_miss) continue;
        min_miss = miss;
        winner = &disc;
      }
    }
    if (winner == nullptr) return {point, 0.0F};
    Disc chosen = *winner;
    if (smooth_) blend(cell, chosen);
    return {raster_.from_cells({chosen.x, chosen.y}), chosen.radius * raster_.cell()};
  }

  // Sets `chosen` to the mean of the discs reaching p; weight: r^8 (1 - |p - c|^2 / (reach r)^2)^2.
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
  int min_side_cells_ = 0;
  KernelTuning tuning_;
  float nominal_cell_ = 1.0F;  // [cells of the raster]
  FootprintRaster raster_;
  RidgeDiscs ridge_;
  CellSamples samples_;
  ReachingDiscs discs_, near_;  // largest first; near_: those that may reach the current tile
  std::vector<Eigen::Vector2f> points_;  // [cells]
  std::vector<std::uint32_t> tile_of_;   // tile of each point
  IndexGroups tiles_;
};

// Projects a mesh along a direction and provides the silhouette of each part.
class PartSilhouettes {
 public:
  PartSilhouettes(const ShadowMesh& mesh, const Eigen::Vector3d& up)
      : mesh_(mesh), view_(PlaneFrame::make(canonical_direction(up), Eigen::Vector3d::Zero())) {
    const std::size_t count = mesh.positions.size();
    projected_.reserve(count);
    for (const glm::vec3& p : mesh.positions)
      projected_.push_back(view_.to_plane(to_eigen(p)).head<2>());
    positions_.sort(count, mesh.part_count, [&](std::size_t i) { return mesh.part[i]; });
    faces_.sort(mesh.indices.size() / 3, mesh.part_count,
                [&](std::size_t face) { return mesh.part[mesh.indices[3 * face]]; });
    std::vector<std::uint32_t> local(count);
    points_.reserve(count);
    for (std::size_t part = 0; part < mesh.part_count; ++part) {
      std::uint32_t next = 0;
      for (const std::uint32_t i : positions_[part]) {
        local[i] = next++;
        points_.push_back((projected_[i] - projected_[positions_[part].front()]).cast<float>());
      }
    }
    corners_.reserve(mesh.indices.size());
    for (const std::uint32_t face : faces_.indices()) {
      for (std::size_t corner = 0; corner < 3; ++corner)
        corners_.push_back(local[mesh.indices[std::size_t{3} * face + corner]]);
    }
  }

  [[nodiscard]] const PlaneFrame& view() const { return view_; }
  // Returns one point per mesh position.
  [[nodiscard]] std::span<const Eigen::Vector2d> projected() const { return projected_; }
  // Returns the mesh positions of a part, in the order of the part's points.
  [[nodiscard]] std::span<const std::uint32_t> positions(std::size_t part) const {
    return positions_[part];
  }
  [[nodiscard]] PartGeometry geometry(std::size_t part) const {
    return {std::span(points_).subspan(positions_.begin(part), positions_[part].size()),
            std::span(corners_).subspan(3 * faces_.begin(part), 3 * faces_[part].size()),
            !mesh_.joined.empty() && mesh_.joined[part]};
  }
  // Converts a point of a part's silhouette to the object frame.
  [[nodiscard]] glm::vec3 in_object(std::size_t part, const Eigen::Vector2f& p) const {
    const Eigen::Vector3d first = to_eigen(mesh_.positions[positions_[part].front()]);
    const Eigen::Vector3d q =
        first + static_cast<double>(p.x()) * view_.e1 + static_cast<double>(p.y()) * view_.e2;
    return {q.x(), q.y(), q.z()};
  }

 private:
  const ShadowMesh& mesh_;
  PlaneFrame view_;
  std::vector<Eigen::Vector2d> projected_;
  IndexGroups positions_, faces_;        // by part
  std::vector<Eigen::Vector2f> points_;  // relative to the part's first point
  std::vector<std::uint32_t> corners_;   // indices into the part's points, three per face
};

ShadowKernels generate_for_direction(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                     KernelSource source, KernelProgress* progress,
                                     const KernelTuning& tuning) {
  ShadowKernels result;
  result.up = up.normalized();
  const PartSilhouettes parts(mesh, up);
  const std::span<const Eigen::Vector2d> projected = parts.projected();
  const std::size_t count = projected.size();
  result.kernels.resize(count);
  const auto set_kernel = [&](std::size_t i, const Eigen::Vector2d& to_kernel) {
    const Eigen::Vector3d k = to_eigen(mesh.positions[i]) + to_kernel.x() * parts.view().e1 +
                              to_kernel.y() * parts.view().e2;
    // If the kernel overflows the range of floats, the vertex is its own kernel.
    const bool fits = (k.array().abs() <= std::numeric_limits<float>::max()).all();
    result.kernels[i] = fits ? glm::vec3(k.x(), k.y(), k.z()) : mesh.positions[i];
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

  LocalThickness thickness(source == KernelSource::smooth, mesh.part_count, progress, tuning);
  result.radius.resize(count);
  std::vector<PlanarKernel> kernels;
  for (std::size_t part = 0; part < mesh.part_count; ++part) {
    const PartGeometry geometry = parts.geometry(part);
    kernels.resize(geometry.points.size());
    thickness.generate(geometry, kernels);
    for (std::size_t i = 0; i < kernels.size(); ++i) {
      const std::uint32_t position = parts.positions(part)[i];
      set_kernel(position, (kernels[i].centre - geometry.points[i]).cast<double>());
      result.radius[position] = kernels[i].radius;
    }
  }
  return result;
}

// Layered Penumbrae, section 5.3, in the form of docs/shadows.md#kernel-directions: k = sum of
// d_i^2 k_i over the sets k_i made for up = axis i. Exact only for directions along an axis.
ShadowKernels compose_per_axis(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                               KernelProgress* progress, const KernelTuning& tuning) {
  const Eigen::Vector3d d = up.normalized();
  ShadowKernels result;
  result.up = d;
  std::vector<Eigen::Vector3d> sum(mesh.positions.size(), Eigen::Vector3d::Zero());
  result.radius.assign(mesh.positions.size(), 0.0F);
  for (int axis = 0; axis < 3; ++axis) {
    const double weight = d[axis] * d[axis];
    if (weight <= 0.0) continue;
    const ShadowKernels set = generate_for_direction(mesh, Eigen::Vector3d::Unit(axis),
                                                     KernelSource::automatic, progress, tuning);
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
                               KernelSource source, KernelProgress* progress,
                               const KernelTuning& tuning) {
  PENUMBRA_ASSERT(up.allFinite() && up.squaredNorm() > 0.0);
  const bool per_axis = source == KernelSource::per_axis;
  if (progress != nullptr) {
    const auto sets = per_axis ? static_cast<std::size_t>((up.array() != 0.0).count()) : 1U;
    progress->total = sets * mesh.positions.size();
  }
  ShadowKernels kernels = per_axis ? compose_per_axis(mesh, up, progress, tuning)
                                   : generate_for_direction(mesh, up, source, progress, tuning);
  if (progress != nullptr) progress->done = progress->total.load();
  return kernels;
}

std::vector<PartDisc> part_discs(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                 double finest_cell, bool across_joints) {
  PENUMBRA_ASSERT(up.allFinite() && up.squaredNorm() > 0.0);
  const PartSilhouettes parts(mesh, up);
  LocalThickness thickness(false, mesh.part_count);
  const float finest_cell_m =
      static_cast<float>(finest_cell) * extent_of(parts.projected()).maxCoeff();
  std::vector<PartDisc> discs(mesh.part_count);
  for (std::size_t part = 0; part < mesh.part_count; ++part) {
    PartGeometry geometry = parts.geometry(part);
    geometry.joined = geometry.joined && across_joints;
    const PlanarKernel disc = thickness.median(geometry, finest_cell_m);
    discs[part] = {parts.in_object(part, disc.centre), disc.radius};
  }
  return discs;
}

std::vector<SilhouettePoint> silhouette_points(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                                               int cells) {
  PENUMBRA_ASSERT(up.allFinite() && up.squaredNorm() > 0.0 && cells > 0);
  const PartSilhouettes parts(mesh, up);
  LocalThickness thickness(false, mesh.part_count);
  const float finest_cell_m = extent_of(parts.projected()).maxCoeff() / static_cast<float>(cells);
  std::vector<SilhouettePoint> points;
  if (!(finest_cell_m > 0.0F) || !std::isfinite(finest_cell_m)) return points;
  std::vector<Eigen::Vector2f> positions;
  std::vector<PlanarKernel> kernels;
  for (std::size_t part = 0; part < mesh.part_count; ++part) {
    const float side = thickness.sample(parts.geometry(part), finest_cell_m, positions, kernels);
    for (std::size_t i = 0; i < positions.size(); ++i) {
      points.push_back(
          {parts.in_object(part, positions[i]), parts.in_object(part, kernels[i].centre), side});
    }
  }
  return points;
}

}  // namespace penumbra
