#include "render/shadow/casters/caster_geometry.hpp"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <optional>
#include <unordered_map>

#include "core/assert.hpp"

namespace penumbra {
namespace {

constexpr float kEdgeRatio = 1.41421356F;  // ratio of longest edges of consecutive coarser meshes

float longest_edge_of(const CasterGeometry& g) {
  float longest = 0.0F;
  for (std::size_t i = 0; i + 2 < g.indices.size(); i += 3) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      longest = std::max(longest, glm::distance(g.positions[g.indices[i + corner]],
                                                g.positions[g.indices[i + (corner + 1) % 3]]));
    }
  }
  return longest;
}

// Appends a triangle, split at the given midpoints of its edges. midpoints[i] belongs to the edge
// from corners[i].
template <class Vertex>
void append_split(std::array<Vertex, 3> corners, std::array<std::optional<Vertex>, 3> midpoints,
                  std::vector<Vertex>& to) {
  const auto& [a, b, c] = corners;
  const auto& [ab, bc, ca] = midpoints;
  const auto rotate_corners = [&] {
    std::ranges::rotate(corners, corners.begin() + 1);
    std::ranges::rotate(midpoints, midpoints.begin() + 1);
  };
  switch (3 - std::ranges::count(midpoints, false, &std::optional<Vertex>::has_value)) {
    case 0:
      to.insert(to.end(), {a, b, c});
      return;
    case 1:
      while (!ab) rotate_corners();
      to.insert(to.end(), {a, *ab, c, *ab, b, c});
      return;
    case 2:
      while (ca) rotate_corners();
      to.insert(to.end(), {*ab, b, *bc, a, *ab, *bc, a, *bc, c});
      return;
    default:
      to.insert(to.end(), {a, *ab, *ca, *ab, b, *bc, *ca, *bc, c, *ab, *bc, *ca});
  }
}

// Halves every edge longer than `max_edge_m`, in all faces at the edge.
void split_once(CasterGeometry& g, float max_edge_m) {
  std::unordered_map<std::uint64_t, std::uint32_t> midpoints;
  std::vector<std::uint32_t> next;
  next.reserve(g.indices.size() * 2);
  const auto midpoint = [&](std::uint32_t a, std::uint32_t b) -> std::optional<std::uint32_t> {
    if (!(glm::distance(g.positions[a], g.positions[b]) > max_edge_m)) return std::nullopt;
    const auto [low, high] = std::minmax({a, b});
    const auto [entry, is_new] =
        midpoints.try_emplace(static_cast<std::uint64_t>(low) << 32U | high,
                              static_cast<std::uint32_t>(g.positions.size()));
    if (is_new) {
      g.positions.push_back(0.5F * (g.positions[a] + g.positions[b]));
      g.midpoint_of.push_back({low, high});
    }
    return entry->second;
  };
  for (std::size_t i = 0; i + 2 < g.indices.size(); i += 3) {
    const auto [a, b, c] = std::array{g.indices[i], g.indices[i + 1], g.indices[i + 2]};
    append_split<std::uint32_t>({a, b, c}, {midpoint(a, b), midpoint(b, c), midpoint(c, a)}, next);
  }
  g.indices = std::move(next);
}

PlanePoint middle(const PlanePoint& a, const PlanePoint& b) {
  return {0.5F * (a.u + b.u), 0.5F * (a.v + b.v)};
}

}  // namespace

CasterGeometry split_long_edges(const ShadowMesh& mesh, float max_edge_m,
                                std::size_t max_triangles) {
  CasterGeometry g;
  g.positions = mesh.positions;
  g.indices = mesh.indices;
  g.mesh_positions = mesh.positions.size();
  if (!(max_edge_m > 0.0F)) return g;
  float longest = longest_edge_of(g);
  if (!std::isfinite(longest)) return g;
  // Splits the longest edges first, so that coarser meshes contain only the splits they need.
  float length = max_edge_m;
  while (length * kEdgeRatio < longest) length *= kEdgeRatio;
  for (; longest > max_edge_m && g.indices.size() / 3 < max_triangles;
       length = std::max(max_edge_m, length / kEdgeRatio)) {
    if (!(longest > length)) continue;
    g.coarser.push_back({g.indices, longest});
    do {
      split_once(g, length);
      longest = longest_edge_of(g);
    } while (longest > length && g.indices.size() / 3 < max_triangles);
  }
  return g;
}

void add_midpoints(const CasterGeometry& geometry, std::vector<PlanePoint>& points) {
  PENUMBRA_ASSERT(points.size() == geometry.mesh_positions);
  points.reserve(geometry.positions.size());
  for (const auto& [a, b] : geometry.midpoint_of) points.push_back(middle(points[a], points[b]));
}

std::vector<PlanePoint> split_long_edges(std::vector<PlanePoint> triangles, float longest) {
  constexpr std::size_t kMaxTriangles = 200'000;
  if (!(longest > 0.0F)) return triangles;
  bool splitting = true;
  const auto midpoint = [&](const PlanePoint& a, const PlanePoint& b) -> std::optional<PlanePoint> {
    const float u = b.u - a.u;
    const float v = b.v - a.v;
    if (!(u * u + v * v > longest * longest)) return std::nullopt;
    splitting = true;
    return middle(a, b);
  };
  std::vector<PlanePoint> next;
  while (splitting && triangles.size() / 3 < kMaxTriangles) {
    splitting = false;
    next.clear();
    next.reserve(triangles.size());
    for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
      const auto [a, b, c] = std::array{triangles[i], triangles[i + 1], triangles[i + 2]};
      append_split<PlanePoint>({a, b, c}, {midpoint(a, b), midpoint(b, c), midpoint(c, a)}, next);
    }
    triangles.swap(next);
  }
  return triangles;
}

std::vector<glm::vec3> level_kernels(const CasterGeometry& geometry, const ShadowKernels& kernels) {
  PENUMBRA_ASSERT(kernels.kernels.size() == geometry.mesh_positions);
  const glm::vec3 up(kernels.up.x(), kernels.up.y(), kernels.up.z());
  std::vector<glm::vec3> levelled;
  levelled.reserve(geometry.positions.size());
  for (std::size_t i = 0; i < geometry.mesh_positions; ++i) {
    const glm::vec3& k = kernels.kernels[i];
    levelled.push_back(k + glm::dot(geometry.positions[i] - k, up) * up);
  }
  for (const auto& [a, b] : geometry.midpoint_of)
    levelled.push_back(0.5F * (levelled[a] + levelled[b]));
  return levelled;
}

}  // namespace penumbra
