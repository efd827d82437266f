#include "render/model/shadow_mesh.hpp"

#include <fmt/format.h>
#include <algorithm>
#include <array>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <limits>
#include <numeric>

#include "render/model/cut_out.hpp"
#include "render/model/part_groups.hpp"
#include "render/model/to_eigen.hpp"

namespace penumbra {
namespace {

// Welding makes kernels independent of texture seams and of unconnected triangles.
constexpr double kWeldDistance = 10e-6;  // [m]
constexpr double kWeldShare = 1e-4;      // maximum weld distance / longest side of the model
// Relative distance of equal vertices after rounding: a few steps of float.
constexpr double kRounding = 4.0 * 1.1920929e-7;
// Cell size of the search grid in weld distances, so that most searches visit only one cell.
constexpr double kCellSize = 8.0;
constexpr std::size_t kMaxPieces = 100'000;  // maximum number of triangles from cut faces

struct CellIndex {
  std::int64_t x, y, z;
  bool operator==(const CellIndex&) const = default;
};

std::uint64_t hash_of(const CellIndex& cell) {
  std::uint64_t hash = static_cast<std::uint64_t>(cell.x) * 0x9e3779b97f4a7c15ULL;
  hash = (hash ^ (hash >> 29U) ^ static_cast<std::uint64_t>(cell.y)) * 0xbf58476d1ce4e5b9ULL;
  hash = (hash ^ (hash >> 32U) ^ static_cast<std::uint64_t>(cell.z)) * 0x94d049bb133111ebULL;
  return hash ^ (hash >> 31U);
}

// Open-addressed hash table of cells; the positions of a cell form a linked list.
class WeldGrid {
 public:
  // Welds positions up to `distance` [m] apart; 0: only equal ones.
  WeldGrid(std::size_t expected, double distance)
      : squared_distance_(distance * distance),
        cells_per_m_(1.0 / (kCellSize * std::max(distance, kMinDistance_m))) {
    std::size_t size = 64;
    while (size < 2 * expected) size *= 2;
    slots_.resize(size, kNone);
    cells_.resize(size);
    next_.reserve(expected);
  }

  // Returns the index of a position within the weld distance, adding one if there is none.
  std::uint32_t find_or_add(const glm::vec3& p, std::vector<glm::vec3>& positions) {
    const double x = static_cast<double>(p.x) * cells_per_m_;
    const double y = static_cast<double>(p.y) * cells_per_m_;
    const double z = static_cast<double>(p.z) * cells_per_m_;
    const CellIndex home = {cell_of(x), cell_of(y), cell_of(z)};
    const std::uint32_t found = search(home, p, positions);
    if (found != kNone) return found;
    constexpr double kCellsAround = 1.0 / kCellSize;
    for (std::int64_t cx = cell_of(x - kCellsAround); cx <= cell_of(x + kCellsAround); ++cx) {
      for (std::int64_t cy = cell_of(y - kCellsAround); cy <= cell_of(y + kCellsAround); ++cy) {
        for (std::int64_t cz = cell_of(z - kCellsAround); cz <= cell_of(z + kCellsAround); ++cz) {
          const CellIndex cell = {cx, cy, cz};
          if (cell == home) continue;
          const std::uint32_t near = search(cell, p, positions);
          if (near != kNone) return near;
        }
      }
    }
    const auto index = static_cast<std::uint32_t>(positions.size());
    positions.push_back(p);
    next_.resize(positions.size(), kNone);
    if (2 * positions.size() > slots_.size()) grow();
    const std::size_t slot = slot_of(home);
    cells_[slot] = home;
    next_[index] = slots_[slot];
    slots_[slot] = index;
    return index;
  }

 private:
  static constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();
  static constexpr double kMinDistance_m = 1e-30;  // [m]; the cell size must not be 0

  void grow() {
    std::vector<std::uint32_t> slots(2 * slots_.size(), kNone);
    std::vector<CellIndex> cells(2 * cells_.size());
    slots.swap(slots_);
    cells.swap(cells_);
    for (std::size_t i = 0; i < slots.size(); ++i) {
      if (slots[i] == kNone) continue;
      const std::size_t slot = slot_of(cells[i]);
      slots_[slot] = slots[i];
      cells_[slot] = cells[i];
    }
  }
  static std::int64_t cell_of(double coordinate) {
    // Larger than any model; larger values would overflow the integer.
    constexpr double kFar = 1e18;
    return static_cast<std::int64_t>(std::floor(std::clamp(coordinate, -kFar, kFar)));
  }
  [[nodiscard]] std::size_t slot_of(const CellIndex& cell) const {
    const std::size_t mask = slots_.size() - 1;
    std::size_t slot = hash_of(cell) & mask;
    while (slots_[slot] != kNone && !(cells_[slot] == cell)) slot = (slot + 1) & mask;
    return slot;
  }
  [[nodiscard]] std::uint32_t search(const CellIndex& cell, const glm::vec3& p,
                                     const std::vector<glm::vec3>& positions) const {
    for (std::uint32_t i = slots_[slot_of(cell)]; i != kNone; i = next_[i]) {
      const glm::dvec3 d = glm::dvec3(positions[i]) - glm::dvec3(p);
      if (glm::dot(d, d) <= squared_distance_) return i;
    }
    return kNone;
  }

  double squared_distance_;  // [m^2]
  double cells_per_m_;
  std::vector<std::uint32_t> slots_;  // first position of the cell
  std::vector<CellIndex> cells_;
  std::vector<std::uint32_t> next_;  // next position of the same cell
};

class UnionFind {
 public:
  explicit UnionFind(std::size_t count) : parent_(count) {
    std::iota(parent_.begin(), parent_.end(), 0U);
  }
  std::uint32_t root(std::uint32_t i) {
    while (parent_[i] != i) {
      parent_[i] = parent_[parent_[i]];
      i = parent_[i];
    }
    return i;
  }
  // Makes the lower index the root, so that parts are numbered by their first position.
  void join(std::uint32_t a, std::uint32_t b) {
    const auto [low, high] = std::minmax({root(a), root(b)});
    parent_[high] = low;
  }

 private:
  std::vector<std::uint32_t> parent_;
};

// Separates vertices at the same position that have different kernels.
class KernelSplitter {
 public:
  // `welded`: index of the position that the vertex was welded to, possibly new.
  std::uint32_t position_for(std::uint32_t welded, const glm::vec3& kernel, ShadowMesh& mesh) {
    if (next_.size() <= welded) next_.resize(welded + 1U, kNoShadowPosition);
    for (std::size_t i = mesh.stored_kernels.size(); i <= welded; ++i) {
      mesh.stored_kernels.push_back(kernel);
    }
    std::uint32_t last = welded;
    for (std::uint32_t i = welded; i != kNoShadowPosition;
         i = i < next_.size() ? next_[i] : kNoShadowPosition) {
      if (mesh.stored_kernels[i] == kernel) return i;
      last = i;
    }
    const auto twin = static_cast<std::uint32_t>(mesh.positions.size());
    mesh.positions.push_back(mesh.positions[welded]);
    mesh.stored_kernels.push_back(kernel);
    next_.resize(twin + 1U, kNoShadowPosition);
    next_[last] = twin;
    twins_.push_back({welded, twin});
    return twin;
  }
  [[nodiscard]] const std::vector<std::array<std::uint32_t, 2>>& twins() const { return twins_; }

 private:
  std::vector<std::uint32_t> next_;  // linked list of the positions at the same point
  std::vector<std::array<std::uint32_t, 2>> twins_;
};

// Collects one position of each face of the mesh that belongs to the group.
void collect_group(const Mesh& source, const std::vector<std::uint32_t>& welded,
                   const std::vector<bool>& members, const std::string& group,
                   std::vector<std::uint32_t>& positions) {
  const auto collect = [&](std::size_t first, std::size_t count) {
    for (std::size_t i = first; i < first + count && i < source.indices.size(); i += 3) {
      const std::uint32_t vertex = source.indices[i];
      if (vertex < welded.size() && welded[vertex] != kNoShadowPosition) {
        positions.push_back(welded[vertex]);
      }
    }
  };
  if (group == kGroupOfAll) {
    collect(0, source.indices.size());
    return;
  }
  for (const NodeFaces& run : source.node_faces) {
    if (members[run.node]) collect(run.first_index, run.index_count);
  }
}

struct Welding {
  bool stored = false;                          // keeps the model's stored kernels
  std::optional<int> cut_depth = std::nullopt;  // depth for append_visible(); nullopt: whole faces
};

class Welder {
 public:
  Welder(const Model& model, std::span<const std::string> groups, const Welding& welding)
      : model_(model), groups_(groups), welding_(welding), grid_(0, 0.0) {}

  [[nodiscard]] ShadowMesh make();

 private:
  void weld_vertices(const Mesh& source);
  void add_faces(const Mesh& source);
  void add_face(const std::array<std::uint32_t, 3>& face);
  void add_pieces(const FaceOpacity& opacity, std::size_t index, std::uint32_t corner);
  void make_parts();

  const Model& model_;
  std::span<const std::string> groups_;
  Welding welding_;
  ShadowMesh mesh_;
  WeldGrid grid_;
  KernelSplitter splitter_;
  std::vector<std::uint32_t> welded_;  // position of each vertex of the current mesh
  std::vector<std::array<std::uint32_t, 2>> collapsed_edges_;
  std::vector<std::array<std::uint32_t, 2>> pieces_;  // pairs of one cut face
  std::vector<std::vector<std::uint32_t>> grouped_;   // per group: one position of each face
};

void Welder::weld_vertices(const Mesh& source) {
  welded_.resize(source.positions.size());
  for (std::size_t i = 0; i < source.positions.size(); ++i) {
    // add_faces() skips faces with non-finite vertices.
    welded_[i] = is_finite(source.positions[i])
                     ? grid_.find_or_add(source.positions[i], mesh_.positions)
                     : kNoShadowPosition;
    if (welding_.stored && welded_[i] != kNoShadowPosition && i < source.shadow_kernels.size()) {
      welded_[i] = splitter_.position_for(welded_[i], source.shadow_kernels[i], mesh_);
    }
    if (i < source.source_vertex.size() && source.source_vertex[i] < mesh_.from_source.size()) {
      mesh_.from_source[source.source_vertex[i]] = welded_[i];
    }
  }
}

void Welder::add_face(const std::array<std::uint32_t, 3>& face) {
  if (face[0] == face[1] || face[1] == face[2] || face[2] == face[0]) {
    // A face collapsed to an edge has no area but connects its neighbours.
    collapsed_edges_.push_back({face[0], face[0] == face[1] ? face[2] : face[1]});
    return;
  }
  mesh_.indices.insert(mesh_.indices.end(), face.begin(), face.end());
}

// Adds the visible triangles of a face. `corner`: one position of the face.
void Welder::add_pieces(const FaceOpacity& opacity, std::size_t index, std::uint32_t corner) {
  std::vector<glm::vec3> corners;
  opacity.append_visible(index, *welding_.cut_depth, corners);
  for (std::size_t i = 0; i + 2 < corners.size(); i += 3) {
    std::array<std::uint32_t, 3> piece{};
    for (std::size_t k = 0; k < 3; ++k) {
      piece[k] = grid_.find_or_add(corners[i + k], mesh_.positions);
    }
    if (piece[0] == piece[1] || piece[1] == piece[2] || piece[2] == piece[0]) continue;
    mesh_.indices.insert(mesh_.indices.end(), piece.begin(), piece.end());
    for (const std::uint32_t position : piece) pieces_.push_back({corner, position});
  }
}

void Welder::add_faces(const Mesh& source) {
  const FaceOpacity opacity(model_, source);
  for (std::size_t i = 0; i + 2 < source.indices.size(); i += 3) {
    std::array<std::uint32_t, 3> face{};
    bool usable = true;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const std::uint32_t vertex = source.indices[i + corner];
      face[corner] = vertex < welded_.size() ? welded_[vertex] : kNoShadowPosition;
      usable = usable && face[corner] != kNoShadowPosition;
    }
    if (!usable) continue;
    const FaceVisibility visibility = opacity.visibility(i);
    if (visibility == FaceVisibility::hidden) continue;
    if (visibility == FaceVisibility::partial && welding_.cut_depth) {
      add_pieces(opacity, i, face[0]);
    } else {
      add_face(face);
    }
  }
}

void Welder::make_parts() {
  UnionFind parts(mesh_.positions.size());
  for (std::size_t i = 0; i + 2 < mesh_.indices.size(); i += 3) {
    parts.join(mesh_.indices[i], mesh_.indices[i + 1]);
    parts.join(mesh_.indices[i], mesh_.indices[i + 2]);
  }
  for (const auto& edge : collapsed_edges_) parts.join(edge[0], edge[1]);
  for (const auto& pair : pieces_) parts.join(pair[0], pair[1]);
  for (const auto& twins : splitter_.twins()) parts.join(twins[0], twins[1]);
  std::vector<std::uint32_t> joined;  // one position of each joined part
  for (const std::vector<std::uint32_t>& group : grouped_) {
    for (const std::uint32_t position : group) {
      if (parts.root(position) == parts.root(group.front())) continue;
      parts.join(group.front(), position);
      joined.push_back(position);
    }
  }
  mesh_.part.resize(mesh_.positions.size());
  for (std::uint32_t i = 0; i < mesh_.positions.size(); ++i) {
    const std::uint32_t root = parts.root(i);
    mesh_.part[i] = root == i ? mesh_.part_count++ : mesh_.part[root];
  }
  if (!joined.empty()) mesh_.joined.assign(mesh_.part_count, false);
  for (const std::uint32_t position : joined) mesh_.joined[mesh_.part[position]] = true;
  std::vector<bool> casts(mesh_.part_count, false);
  for (std::size_t i = 0; i < mesh_.indices.size(); i += 3) {
    casts[mesh_.part[mesh_.indices[i]]] = true;
  }
  for (const auto& edge : collapsed_edges_) {
    mesh_.lost_faces += casts[mesh_.part[edge[0]]] ? 0 : 1;
  }
}

ShadowMesh Welder::make() {
  std::size_t vertex_count = 0;
  std::size_t index_count = 0;
  for (const Mesh& source : model_.meshes) {
    vertex_count += source.positions.size();
    index_count += source.indices.size();
  }
  mesh_.positions.reserve(vertex_count);
  mesh_.indices.reserve(index_count);
  mesh_.from_source.assign(model_.source_vertex_count, kNoShadowPosition);
  grid_ = WeldGrid(vertex_count, weld_distance(model_));
  if (welding_.stored) mesh_.stored_up = *model_.shadow_kernel_up;
  std::vector<std::vector<bool>> members;  // per group: flag for each of Model::nodes
  for (const std::string& group : groups_) members.push_back(nodes_of_group(model_, group));
  grouped_.resize(groups_.size());
  for (const Mesh& source : model_.meshes) {
    weld_vertices(source);
    add_faces(source);
    for (std::size_t group = 0; group < members.size(); ++group) {
      collect_group(source, welded_, members[group], groups_[group], grouped_[group]);
    }
  }
  // Vertices without a kernel are their own kernel.
  for (std::size_t i = mesh_.stored_kernels.size(); welding_.stored && i < mesh_.positions.size();
       ++i) {
    mesh_.stored_kernels.push_back(mesh_.positions[i]);
  }
  make_parts();
  return std::move(mesh_);
}

}  // namespace

double weld_distance(const Model& model) {
  const auto greatest = [](const auto& v) { return std::max({v.x, v.y, v.z}); };
  glm::vec3 low(std::numeric_limits<float>::infinity());
  glm::vec3 high(-std::numeric_limits<float>::infinity());
  for (const Mesh& mesh : model.meshes) {
    for (const glm::vec3& p : mesh.positions) {
      if (!is_finite(p)) continue;
      low = glm::min(low, p);
      high = glm::max(high, p);
    }
  }
  if (!(low.x <= high.x)) return 0.0;
  const double distance =
      std::min(kWeldDistance, kWeldShare * greatest(glm::dvec3(high) - glm::dvec3(low)));
  const double largest = greatest(glm::dvec3(glm::max(glm::abs(low), glm::abs(high))));
  if (kRounding * largest <= distance) return distance;
  // Uses the median coordinate, so that a single distant vertex does not cause welding of others.
  std::vector<float> coordinates;
  for (const Mesh& mesh : model.meshes) {
    for (const glm::vec3& p : mesh.positions) {
      if (is_finite(p)) coordinates.push_back(greatest(glm::abs(p)));
    }
  }
  const auto median = coordinates.begin() + static_cast<std::ptrdiff_t>(coordinates.size() / 2);
  std::nth_element(coordinates.begin(), median, coordinates.end());
  return std::max(distance, kRounding * static_cast<double>(*median));
}

ShadowMesh make_shadow_mesh(const Model& model, std::span<const std::string> groups,
                            CutOuts cut_outs) {
  if (groups.empty()) groups = model.shadow_kernel_groups;
  if (cut_outs == CutOuts::visible_regions && has_cut_outs(model)) {
    return Welder(model, groups, {.cut_depth = cut_out_depth(model, kMaxPieces)}).make();
  }
  const bool stored = model.shadow_kernel_up.has_value();
  ShadowMesh mesh = Welder(model, groups, {.stored = stored}).make();
  if (stored && !stored_kernels_fit(model, mesh, groups)) return Welder(model, groups, {}).make();
  return mesh;
}

std::optional<ShadowMesh> moved_to_shape(const ShadowMesh& mesh, const Model& made_from,
                                         const Model& shape, double max_gap) {
  const auto has_same_faces = [](const Mesh& a, const Mesh& b) {
    return a.positions.size() == b.positions.size() && a.indices == b.indices &&
           a.source_vertex == b.source_vertex;
  };
  if (shape.origin != made_from.origin ||
      !std::ranges::equal(shape.meshes, made_from.meshes, has_same_faces))
    return std::nullopt;
  ShadowMesh moved = mesh;
  std::vector<bool> is_set(mesh.positions.size(), false);
  const auto max_squared = static_cast<float>(max_gap * max_gap);
  for (const Mesh& source : shape.meshes) {
    for (std::size_t i = 0; i < source.positions.size(); ++i) {
      const std::uint32_t to = mesh.from_source[source.source_vertex[i]];
      if (to == kNoShadowPosition) continue;
      const glm::vec3& p = source.positions[i];
      if (!is_finite(p)) return std::nullopt;
      const glm::vec3 gap = p - moved.positions[to];
      // The first of the welded vertices gives the position, as in make_shadow_mesh().
      if (!is_set[to]) {
        moved.positions[to] = p;
        is_set[to] = true;
      } else if (!(glm::dot(gap, gap) <= max_squared)) {
        return std::nullopt;
      }
    }
  }
  return moved;
}

std::optional<std::string> warning_of_lost_faces(const Model& model, const std::string& file) {
  // Only edges up to twice the weld distance can collapse.
  const double distance = weld_distance(model);
  const auto is_short = [&](const glm::vec3& a, const glm::vec3& b) {
    const glm::dvec3 d = glm::dvec3(a) - glm::dvec3(b);
    return glm::dot(d, d) <= 4.0 * distance * distance;
  };
  std::size_t faces = 0;
  bool any_short = false;
  for (const Mesh& mesh : model.meshes) {
    faces += mesh.indices.size() / 3;
    for (std::size_t i = 0; i + 2 < mesh.indices.size() && !any_short; i += 3) {
      const auto corner = [&](std::size_t j) { return mesh.positions[mesh.indices[i + j]]; };
      any_short = is_short(corner(0), corner(1)) || is_short(corner(1), corner(2)) ||
                  is_short(corner(2), corner(0));
    }
  }
  if (!any_short) return std::nullopt;
  const std::size_t lost = Welder(model, {}, {}).make().lost_faces;
  if (lost == 0) return std::nullopt;
  if (lost == faces) {
    // At this distance, the six digits that many programs write are too coarse.
    constexpr double kFar = 100.0;  // [m]
    const double far = model.origin.norm();
    const std::string remedy =
        far > kFar
            ? fmt::format("it lies {:.4g} km from its origin; move it there and export it again",
                          1e-3 * far)
            : "export it again, in larger units";
    return fmt::format(
        "{}: casts no shadow: its {} faces have no area, with corners at one place; {}", file,
        faces, remedy);
  }
  return fmt::format(
      "{}: {} of its {} faces cast no shadow: their parts are smaller than {:.2g} m, the "
      "resolution of this model's shadow; remove what lies far from the rest, or make them larger",
      file, lost, faces, distance);
}

KernelStamp kernel_stamp_from(std::string_view word) {
  KernelStamp stamp;
  const std::size_t first = word.find('-');
  stamp.geometry = word.substr(0, first);
  if (first == std::string_view::npos) return stamp;
  const std::string_view rest = word.substr(first + 1);
  const std::size_t second = rest.find('-');
  stamp.parts = rest.substr(0, second);
  if (second != std::string_view::npos) stamp.source = rest.substr(second + 1);
  return stamp;
}

std::string parts_key(const ShadowMesh& mesh) {
  std::uint64_t hash = 1469598103934665603ULL;  // FNV-1a over 32-bit words
  std::vector<std::uint32_t> number(mesh.part_count, kNoShadowPosition);
  std::uint32_t count = 0;
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    std::uint32_t& part = number[mesh.part[mesh.indices[i]]];
    if (part == kNoShadowPosition) part = count++;
    hash = (hash ^ part) * 1099511628211ULL;
  }
  return fmt::format("{:016x}", hash);
}

bool stored_kernels_fit(const Model& model, const ShadowMesh& mesh,
                        std::span<const std::string> groups) {
  if (groups.empty() || model.shadow_kernel_geometry.empty()) return true;
  return kernel_stamp_from(model.shadow_kernel_geometry).parts == parts_key(mesh);
}

}  // namespace penumbra
