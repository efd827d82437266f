#include "render/shadow/shadow_kernels.hpp"

#include <cmath>

#include "core/assert.hpp"
#include "render/shadow/footprint.hpp"
#include "render/shadow/plane_frame.hpp"

namespace penumbra {

namespace {

constexpr int kCentroidCells = 128;

// One of d and -d, the same for both: a silhouette seen from behind has the same kernels.
Eigen::Vector3d canonical_direction(const Eigen::Vector3d& up) {
  const Eigen::Vector3d d = up.normalized();
  const bool flip = d.z() < 0.0 || (d.z() == 0.0 && (d.y() < 0.0 || (d.y() == 0.0 && d.x() < 0.0)));
  return flip ? Eigen::Vector3d(-d) : d;
}

// Adds the kernels of one set of positions that share a centre.
Eigen::Vector2d centre_of(std::span<const Eigen::Vector2d> points,
                          std::span<const std::uint32_t> faces) {
  return footprint_centroid(rasterise_footprint(points, faces, kCentroidCells), points);
}

}  // namespace

ShadowKernels generate_kernels(const ShadowMesh& mesh, const Eigen::Vector3d& up,
                               KernelSource source) {
  PENUMBRA_ASSERT(up.allFinite() && up.squaredNorm() > 0.0);
  ShadowKernels result;
  result.up = up.normalized();
  const PlaneFrame view = PlaneFrame::make(canonical_direction(up), Eigen::Vector3d::Zero());

  std::vector<Eigen::Vector2d> points(mesh.positions.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d p(mesh.positions[i].x, mesh.positions[i].y, mesh.positions[i].z);
    points[i] = view.to_plane(p).head<2>();
  }

  std::vector<Eigen::Vector2d> kernels(points.size());
  if (source == KernelSource::centroid) {
    const Eigen::Vector2d centre = centre_of(points, mesh.indices);
    std::fill(kernels.begin(), kernels.end(), centre);
  } else {
    std::vector<std::vector<Eigen::Vector2d>> part_points(mesh.part_count);
    std::vector<std::vector<std::uint32_t>> part_faces(mesh.part_count);
    std::vector<std::uint32_t> place(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      place[i] = static_cast<std::uint32_t>(part_points[mesh.part[i]].size());
      part_points[mesh.part[i]].push_back(points[i]);
    }
    for (const std::uint32_t index : mesh.indices) {
      part_faces[mesh.part[index]].push_back(place[index]);
    }
    std::vector<Eigen::Vector2d> centres(mesh.part_count);
    for (std::size_t part = 0; part < mesh.part_count; ++part) {
      centres[part] = centre_of(part_points[part], part_faces[part]);
    }
    for (std::size_t i = 0; i < points.size(); ++i) kernels[i] = centres[mesh.part[i]];
  }

  result.kernels.resize(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d p(mesh.positions[i].x, mesh.positions[i].y, mesh.positions[i].z);
    const Eigen::Vector2d to_kernel = kernels[i] - points[i];
    const Eigen::Vector3d k = p + to_kernel.x() * view.e1 + to_kernel.y() * view.e2;
    result.kernels[i] =
        glm::vec3(static_cast<float>(k.x()), static_cast<float>(k.y()), static_cast<float>(k.z()));
  }
  return result;
}

}  // namespace penumbra
