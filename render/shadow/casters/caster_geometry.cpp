#include "render/shadow/casters/caster_geometry.hpp"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <unordered_map>

#include "core/assert.hpp"

namespace penumbra {
namespace {

constexpr std::uint32_t kNotSplit = 0xFFFFFFFFU;

std::uint64_t edge_key(std::uint32_t a, std::uint32_t b) {
  return static_cast<std::uint64_t>(std::min(a, b)) << 32U | std::max(a, b);
}

constexpr float kCoarser = 1.41421356F;  // between the lengths of one surface and the next

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

// Halves every edge that is longer than this, in all of its faces.
void split_once(CasterGeometry& g, float max_edge_m) {
  std::unordered_map<std::uint64_t, std::uint32_t> midpoints;
  std::vector<std::uint32_t> next;
  next.reserve(g.indices.size() * 2);
  const auto midpoint = [&](std::uint32_t a, std::uint32_t b) {
    if (!(glm::distance(g.positions[a], g.positions[b]) > max_edge_m)) return kNotSplit;
    const auto [entry, is_new] =
        midpoints.try_emplace(edge_key(a, b), static_cast<std::uint32_t>(g.positions.size()));
    if (is_new) {
      g.positions.push_back(0.5F * (g.positions[a] + g.positions[b]));
      g.midpoint_of.push_back({std::min(a, b), std::max(a, b)});
    }
    return entry->second;
  };
  const auto add = [&next](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    next.insert(next.end(), {a, b, c});
  };
  for (std::size_t i = 0; i + 2 < g.indices.size(); i += 3) {
    std::array<std::uint32_t, 3> v = {g.indices[i], g.indices[i + 1], g.indices[i + 2]};
    std::array<std::uint32_t, 3> m = {midpoint(v[0], v[1]), midpoint(v[1], v[2]),
                                      midpoint(v[2], v[0])};  // of the edge that starts at v
    const auto count = 3 - std::ranges::count(m, kNotSplit);
    const auto turn = [&] {
      std::ranges::rotate(v, v.begin() + 1);
      std::ranges::rotate(m, m.begin() + 1);
    };
    if (count == 0) {
      add(v[0], v[1], v[2]);
    } else if (count == 1) {
      while (m[0] == kNotSplit) turn();
      add(v[0], m[0], v[2]);
      add(m[0], v[1], v[2]);
    } else if (count == 2) {
      while (m[2] != kNotSplit) turn();
      add(m[0], v[1], m[1]);
      add(v[0], m[0], m[1]);
      add(v[0], m[1], v[2]);
    } else {
      add(v[0], m[0], m[2]);
      add(m[0], v[1], m[1]);
      add(m[2], m[1], v[2]);
      add(m[0], m[1], m[2]);
    }
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
  // The longest edges first: a surface that is fine enough for a length has none split that are
  // shorter.
  float length = max_edge_m;
  while (length * kCoarser < longest) length *= kCoarser;
  for (; longest > max_edge_m && g.indices.size() / 3 < max_triangles;
       length = std::max(max_edge_m, length / kCoarser)) {
    if (!(longest > length)) continue;
    g.coarser.push_back({g.indices, longest});
    do {
      split_once(g, length);
      longest = longest_edge_of(g);
    } while (longest > length && g.indices.size() / 3 < max_triangles);
  }
  return g;
}

void add_midpoints(const CasterGeometry& geometry, std::vector<PlanePoint>& images) {
  PENUMBRA_ASSERT(images.size() == geometry.mesh_positions);
  images.reserve(geometry.positions.size());
  for (const auto& [a, b] : geometry.midpoint_of) images.push_back(middle(images[a], images[b]));
}

std::vector<PlanePoint> split_long_edges(std::vector<PlanePoint> triangles, float longest,
                                         std::size_t max_triangles) {
  if (!(longest > 0.0F)) return triangles;
  const auto is_long = [longest](const PlanePoint& a, const PlanePoint& b) {
    const float u = b.u - a.u;
    const float v = b.v - a.v;
    return u * u + v * v > longest * longest;
  };
  std::vector<PlanePoint> next;
  for (bool splitting = true; splitting && triangles.size() / 3 < max_triangles;) {
    splitting = false;
    next.clear();
    next.reserve(triangles.size());
    for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
      std::array<PlanePoint, 3> v = {triangles[i], triangles[i + 1], triangles[i + 2]};
      std::array<bool, 3> split = {is_long(v[0], v[1]), is_long(v[1], v[2]), is_long(v[2], v[0])};
      const auto count = std::ranges::count(split, true);
      if (count == 0) {
        next.insert(next.end(), v.begin(), v.end());
        continue;
      }
      splitting = true;
      const auto turn = [&] {
        std::ranges::rotate(v, v.begin() + 1);
        std::ranges::rotate(split, split.begin() + 1);
      };
      while (!split[0] || (count == 2 && split[2])) turn();
      const PlanePoint ab = middle(v[0], v[1]);
      if (count == 1) {
        next.insert(next.end(), {v[0], ab, v[2], ab, v[1], v[2]});
        continue;
      }
      const PlanePoint bc = middle(v[1], v[2]);
      if (count == 2) {
        next.insert(next.end(), {ab, v[1], bc, v[0], ab, bc, v[0], bc, v[2]});
        continue;
      }
      const PlanePoint ca = middle(v[2], v[0]);
      next.insert(next.end(), {v[0], ab, ca, ab, v[1], bc, ca, bc, v[2], ab, bc, ca});
    }
    triangles.swap(next);
  }
  return triangles;
}

std::vector<glm::vec3> level_kernels(const CasterGeometry& geometry, const ShadowKernels& kernels) {
  PENUMBRA_ASSERT(kernels.kernels.size() == geometry.mesh_positions);
  const glm::vec3 up(static_cast<float>(kernels.up.x()), static_cast<float>(kernels.up.y()),
                     static_cast<float>(kernels.up.z()));
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
