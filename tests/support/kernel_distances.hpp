// Distances of kernels from their vertices, relative to each part's silhouette. The silhouette is
// measured on polygons, independently of the raster that generated the kernels.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "render/scene/plane_frame.hpp"
#include "render/shadow/kernels/shadow_kernels.hpp"
#include "render/shadow/layers/layer_polygons.hpp"
#include "support/shadow_cases.hpp"

namespace penumbra::test {

struct KernelDistance {
  double distance = 0.0;  // |x - k| across `up` [m]
  double inside = 0.0;    // radius of the largest disc about k in its part's silhouette, or 0 [m]
  double cell = 0.0;      // upper bound of the cell size of the part's raster [m]
};

// Returns an entry for each vertex. Entries of vertices without a visible face are 0. Holes of less
// than 0.5 % of a silhouette count as filled, like missing faces (docs/shadows.md#kernels).
inline std::vector<KernelDistance> kernel_distances(const ShadowMesh& mesh,
                                                    const ShadowKernels& kernels) {
  const PlaneFrame plane = PlaneFrame::make(kernels.up, Eigen::Vector3d::Zero());
  const auto flat = [&plane](const glm::vec3& p) -> Eigen::Vector2d {
    return plane
        .to_plane({static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)})
        .head<2>();
  };
  const auto area_of = [](const Ring& ring) {
    double area = 0.0;
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const Eigen::Vector2d& a = ring[i];
      const Eigen::Vector2d& b = ring[(i + 1) % ring.size()];
      area += 0.5 * (a.x() * b.y() - a.y() * b.x());
    }
    return std::abs(area);
  };
  std::vector<KernelDistance> all(mesh.positions.size());
  const KernelTuning tuning;
  for (std::uint32_t part = 0; part < mesh.part_count; ++part) {
    std::vector<PlanePoint> triangles;
    std::vector<bool> has_face(mesh.positions.size(), false);
    for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
      if (mesh.part[mesh.indices[i]] != part) continue;
      for (std::size_t corner = 0; corner < 3; ++corner) {
        const std::uint32_t vertex = mesh.indices[i + corner];
        has_face[vertex] = true;
        const Eigen::Vector2d p = flat(mesh.positions[vertex]);
        triangles.push_back({static_cast<float>(p.x()), static_cast<float>(p.y())});
      }
    }
    const auto outline = union_of_triangles(triangles);
    if (!outline || outline->polygons.empty()) continue;
    std::vector<Ring> rings;
    for (const LayerPolygon& polygon : outline->polygons) {
      rings.push_back(polygon.outer);
      for (const auto& hole : polygon.holes)
        if (area_of(hole) >= 0.005 * outline->area) rings.push_back(hole);
    }
    double points = 0.0;
    Eigen::Vector2d low = rings[0][0];
    Eigen::Vector2d high = low;
    for (const Ring& ring : rings) {
      for (const Eigen::Vector2d& p : ring) {
        low = low.cwiseMin(p);
        high = high.cwiseMax(p);
      }
    }
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) points += has_face[i] ? 1.0 : 0.0;
    const double cells = std::clamp(tuning.cells_per_root * std::sqrt(points),
                                    static_cast<double>(tuning.min_side_cells),
                                    static_cast<double>(tuning.max_side_cells));
    const auto within = [&rings](const Eigen::Vector2d& p) {
      bool odd = false;
      for (const Ring& ring : rings) {
        for (std::size_t i = 0; i < ring.size(); ++i) {
          const Eigen::Vector2d& a = ring[i];
          const Eigen::Vector2d& b = ring[(i + 1) % ring.size()];
          if ((a.y() <= p.y()) == (b.y() <= p.y())) continue;
          if (a.x() + (p.y() - a.y()) / (b.y() - a.y()) * (b.x() - a.x()) > p.x()) odd = !odd;
        }
      }
      return odd;
    };
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      if (!has_face[i]) continue;
      const Eigen::Vector2d k = flat(kernels.kernels[i]);
      all[i].distance = (flat(mesh.positions[i]) - k).norm();
      all[i].inside = within(k) ? distance_to_rings(k, rings) : 0.0;
      all[i].cell = (high - low).norm() / cells;  // the diagonal exceeds either side
    }
  }
  return all;
}

// Upper bound of |x - k|: 1.5 r plus one cell (docs/shadows.md#kernels, rule 5). The raster
// determines r to one cell.
inline double max_allowed_distance(const KernelDistance& kernel) {
  return 1.5 * (kernel.inside + kernel.cell) + kernel.cell;
}

}  // namespace penumbra::test
