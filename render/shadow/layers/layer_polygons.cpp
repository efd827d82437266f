#include "render/shadow/layers/layer_polygons.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <clipper.hpp>
#include <cmath>
#include <cstdint>
#include <numeric>

namespace penumbra {

namespace {

// Half the grid's extent [steps], for which Clipper needs only 64-bit arithmetic.
constexpr double kGridHalf = 5e8;
constexpr double kSpeck = 1e-12;  // [m^2]; smaller polygons are dropped

struct Grid {
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  double step = 0.0;  // [m]

  [[nodiscard]] std::array<std::int32_t, 2> snap(const PlanePoint& p) const {
    return {static_cast<std::int32_t>(std::lround((static_cast<double>(p.u) - middle.x()) / step)),
            static_cast<std::int32_t>(std::lround((static_cast<double>(p.v) - middle.y()) / step))};
  }
  [[nodiscard]] std::vector<Eigen::Vector2d> lift(const ClipperLib::Path& path) const {
    std::vector<Eigen::Vector2d> ring;
    ring.reserve(path.size());
    for (const ClipperLib::IntPoint& p : path) {
      ring.emplace_back(middle.x() + step * static_cast<double>(p.X),
                        middle.y() + step * static_cast<double>(p.Y));
    }
    return ring;
  }
};

Grid grid_around(std::span<const PlanePoint> points) {
  Eigen::AlignedBox2d box;
  for (const PlanePoint& p : points) box.extend(Eigen::Vector2f(p.u, p.v).cast<double>());
  return {0.5 * (box.min() + box.max()), 0.5 * box.sizes().maxCoeff() / kGridHalf};
}

using Corner = std::array<std::int32_t, 2>;

std::uint64_t key_of(const Corner& corner) {
  return (static_cast<std::uint64_t>(static_cast<std::uint32_t>(corner[0])) << 32U) |
         static_cast<std::uint32_t>(corner[1]);
}
Corner corner_of(std::uint64_t key) {
  return {static_cast<std::int32_t>(static_cast<std::uint32_t>(key >> 32U)),
          static_cast<std::int32_t>(static_cast<std::uint32_t>(key))};
}

struct Edge {
  std::uint64_t from, to;
  int count;
};

struct Triangle {
  Corner a, b, c;  // counter-clockwise

  // Returns three times the centroid's coordinate along an axis.
  [[nodiscard]] std::int64_t thrice_centroid(std::size_t axis) const {
    return static_cast<std::int64_t>(a[axis]) + b[axis] + c[axis];
  }
};

// Returns the triangles with non-zero area, oriented counter-clockwise.
std::vector<Triangle> snapped_triangles(std::span<const PlanePoint> points, const Grid& grid) {
  std::vector<Triangle> triangles;
  triangles.reserve(points.size() / 3);
  for (std::size_t i = 0; i + 2 < points.size(); i += 3) {
    const Corner a = grid.snap(points[i]);
    const Corner b = grid.snap(points[i + 1]);
    const Corner c = grid.snap(points[i + 2]);
    const auto difference = [](std::int32_t p, std::int32_t q) {
      return static_cast<std::int64_t>(p) - q;
    };
    // At most 2e18, which fits into 64 bits.
    const std::int64_t area = difference(b[0], a[0]) * difference(c[1], a[1]) -
                              difference(b[1], a[1]) * difference(c[0], a[0]);
    if (area > 0) triangles.push_back({a, b, c});
    if (area < 0) triangles.push_back({a, c, b});
  }
  return triangles;
}

// Returns the boundary of all triangles as directed edges; opposite edges of neighbours cancel. The
// winding number around a point is the number of triangles that cover it.
std::vector<Edge> boundary_edges(std::span<const Triangle> triangles) {
  std::vector<Edge> edges;
  edges.reserve(3 * triangles.size());
  for (const Triangle& triangle : triangles) {
    const std::array corners = {key_of(triangle.a), key_of(triangle.b), key_of(triangle.c)};
    for (std::size_t i = 0; i < 3; ++i) {
      const std::uint64_t from = corners[i];
      const std::uint64_t to = corners[(i + 1) % 3];
      edges.push_back(from < to ? Edge{from, to, 1} : Edge{to, from, -1});
    }
  }
  const auto ends = [](const Edge& edge) { return std::pair(edge.from, edge.to); };
  std::ranges::sort(edges, {}, ends);
  std::vector<Edge> remaining;
  for (std::size_t i = 0; i < edges.size();) {
    Edge sum = edges[i];
    for (++i; i < edges.size() && edges[i].from == sum.from && edges[i].to == sum.to; ++i) {
      sum.count += edges[i].count;
    }
    for (; sum.count > 0; --sum.count) remaining.push_back({sum.from, sum.to, 1});
    for (; sum.count < 0; ++sum.count) remaining.push_back({sum.to, sum.from, 1});
  }
  std::ranges::sort(remaining, {}, ends);
  return remaining;
}

// Joins the edges to closed walks: each corner has equally many incoming and outgoing edges.
ClipperLib::Paths closed_walks(const std::vector<Edge>& edges) {
  ClipperLib::Paths walks;
  std::vector<bool> used(edges.size(), false);
  // Edges are sorted by `from`. next_unused[i], for a corner's first edge i, skips used edges.
  std::vector<std::size_t> next_unused(edges.size());
  std::iota(next_unused.begin(), next_unused.end(), 0U);
  const auto first_from = [&edges](std::uint64_t corner) {
    return static_cast<std::size_t>(std::ranges::lower_bound(edges, corner, {}, &Edge::from) -
                                    edges.begin());
  };
  for (std::size_t start = 0; start < edges.size(); ++start) {
    if (used[start]) continue;
    ClipperLib::Path walk;
    std::size_t edge = start;
    while (true) {
      used[edge] = true;
      const Corner corner = corner_of(edges[edge].from);
      walk.emplace_back(corner[0], corner[1]);
      if (edges[edge].to == edges[start].from) break;
      const std::size_t first = first_from(edges[edge].to);
      std::size_t& next = next_unused[first];
      while (next < edges.size() && edges[next].from == edges[edge].to && used[next]) ++next;
      if (next >= edges.size() || edges[next].from != edges[edge].to) break;
      edge = next;
    }
    walks.push_back(std::move(walk));
  }
  return walks;
}

// Edge limit of the whole union / edge limit of a piece.
constexpr std::size_t kPieceDivisor = 10;

// Returns false if Clipper fails; may throw clipperException.
template <class Solution>
bool unite(const ClipperLib::Paths& paths, Solution& solution) {
  // All faces may be edge-on; Clipper would report an empty input as a failure.
  if (paths.empty()) return true;
  ClipperLib::Clipper clipper;
  clipper.AddPaths(paths, ClipperLib::ptSubject, true);
  return clipper.Execute(ClipperLib::ctUnion, solution, ClipperLib::pftPositive,
                         ClipperLib::pftPositive);
}

// Computes closed paths with positive orientation whose union is the union of the triangles. If the
// boundary is too long, unites each half of the triangles first, which removes inner crossings.
// Reorders the triangles.
bool outline_paths(std::span<Triangle> triangles, std::size_t max_edges,
                   std::size_t max_piece_edges, ClipperLib::Paths& outline) {
  const std::vector<Edge> edges = boundary_edges(triangles);
  if (edges.size() <= max_edges || triangles.size() < 2) {
    outline = closed_walks(edges);
    return true;
  }
  Eigen::AlignedBox<std::int64_t, 2> box;
  for (const Triangle& triangle : triangles)
    box.extend(Eigen::Vector<std::int64_t, 2>(triangle.a[0], triangle.a[1]));
  const std::size_t axis = box.sizes().x() < box.sizes().y() ? 1 : 0;
  const std::size_t half = triangles.size() / 2;
  std::nth_element(triangles.begin(), triangles.begin() + static_cast<std::ptrdiff_t>(half),
                   triangles.end(), [axis](const Triangle& a, const Triangle& b) {
                     return a.thrice_centroid(axis) < b.thrice_centroid(axis);
                   });
  for (const std::span<Triangle>& part : {triangles.first(half), triangles.subspan(half)}) {
    ClipperLib::Paths paths;
    ClipperLib::Paths united;
    if (!outline_paths(part, max_piece_edges, max_piece_edges, paths) || !unite(paths, united))
      return false;
    outline.insert(outline.end(), united.begin(), united.end());
  }
  return true;
}

}  // namespace

Result<LayerOutline> union_of_triangles(std::span<const PlanePoint> triangles,
                                        std::size_t max_edges) {
  LayerOutline outline;
  for (const PlanePoint& p : triangles) {
    if (!std::isfinite(p.u) || !std::isfinite(p.v))
      return fail("shadow layer: has a point that is not finite; check the model and the pose");
  }
  if (triangles.size() < 3) return outline;
  const Grid grid = grid_around(triangles);
  if (!(grid.step > 0.0)) return outline;

  ClipperLib::PolyTree tree;
  try {
    std::vector<Triangle> snapped = snapped_triangles(triangles, grid);
    ClipperLib::Paths paths;
    if (!outline_paths(snapped, max_edges, max_edges / kPieceDivisor, paths) ||
        !unite(paths, tree)) {
      return fail("shadow layer: the union of its triangles failed");
    }
  } catch (const ClipperLib::clipperException& error) {
    return fail("shadow layer: the union of its triangles failed: {}", error.what());
  }

  const double unit = grid.step * grid.step;
  double total_area = 0.0;
  for (const ClipperLib::PolyNode* node = tree.GetFirst(); node != nullptr;
       node = node->GetNext()) {
    total_area += unit * std::abs(ClipperLib::Area(node->Contour)) * (node->IsHole() ? -1.0 : 1.0);
  }
  const double speck = std::min(kSpeck, 1e-9 * total_area);
  for (const ClipperLib::PolyNode* node = tree.GetFirst(); node != nullptr;
       node = node->GetNext()) {
    if (node->IsHole()) continue;
    const double area = unit * std::abs(ClipperLib::Area(node->Contour));
    if (area < speck) continue;
    outline.area += area;
    LayerPolygon polygon;
    polygon.outer = grid.lift(node->Contour);
    for (const ClipperLib::PolyNode* hole : node->Childs) {
      const double hole_area = unit * std::abs(ClipperLib::Area(hole->Contour));
      if (hole_area < speck) continue;
      outline.area -= hole_area;
      polygon.holes.push_back(grid.lift(hole->Contour));
    }
    outline.polygons.push_back(std::move(polygon));
  }
  return outline;
}

}  // namespace penumbra
