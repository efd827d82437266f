#include "render/shadow/kernels/twist.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "render/scene/plane_frame.hpp"
#include "render/shadow/layers/coverage.hpp"

namespace penumbra {

namespace {

// Twice a face's area, the cross product of its sides, is compared with the square of the caster's
// extent.
constexpr double kEdgeOn = 1e-7;

double signed_area(const std::array<Eigen::Vector2d, 3>& p) {
  const Eigen::Vector2d b = p[1] - p[0];
  const Eigen::Vector2d c = p[2] - p[0];
  return 0.5 * (b.x() * c.y() - b.y() * c.x());
}

}  // namespace

TwistReport find_twists(std::span<const CasterVertex> vertices,
                        std::span<const std::uint32_t> indices, double least, double greatest) {
  TwistReport report;
  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d high = -low;
  for (const CasterVertex& vertex : vertices) {
    const Eigen::Vector2d p(static_cast<double>(vertex.u), static_cast<double>(vertex.v));
    if (!p.allFinite()) continue;
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  const double extent = (high - low).maxCoeff();
  const double edge_on = kEdgeOn * extent * extent;

  double tested_area = 0.0;
  double twisted_area = 0.0;
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    // A(s) = A_k + s B + s^2 A_d: of the kernels, of the offsets x - k, and what is left of A(1).
    std::array<Eigen::Vector2d, 3> points;
    std::array<Eigen::Vector2d, 3> kernels;
    std::array<Eigen::Vector2d, 3> offsets;
    bool usable = true;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      if (indices[i + corner] >= vertices.size()) {
        usable = false;
        break;
      }
      const CasterVertex& vertex = vertices[indices[i + corner]];
      points[corner] = {static_cast<double>(vertex.u), static_cast<double>(vertex.v)};
      kernels[corner] = {static_cast<double>(vertex.ku), static_cast<double>(vertex.kv)};
      offsets[corner] = points[corner] - kernels[corner];
    }
    if (!usable) continue;
    const double area = signed_area(points);
    if (!(2.0 * std::abs(area) > edge_on)) continue;  // also where it is not a number
    const double kernel_area = signed_area(kernels);
    const double offset_area = signed_area(offsets);
    const double mixed = area - kernel_area - offset_area;
    const auto turns_over = [&](double s) {
      return (kernel_area + s * (mixed + s * offset_area)) * area < 0.0;
    };
    bool twisted = turns_over(least) || turns_over(greatest);
    const double turning_point = -mixed / (2.0 * offset_area);
    if (turning_point > least && turning_point < greatest) {
      twisted = twisted || turns_over(turning_point);
    }
    ++report.faces_tested;
    tested_area += std::abs(area);
    if (!twisted) continue;
    ++report.faces_twisted;
    twisted_area += std::abs(area);
  }
  if (tested_area > 0.0) report.area_share = twisted_area / tested_area;
  return report;
}

double layer_spill(const ShadowMesh& mesh, const ShadowKernels& kernels, double factor) {
  constexpr int kCells = 192;
  if (mesh.indices.empty()) return 0.0;
  const PlaneFrame plane = PlaneFrame::make(kernels.up, Eigen::Vector3d::Zero());
  const auto to_eigen = [](const glm::vec3& p) {
    return Eigen::Vector3d(static_cast<double>(p.x), static_cast<double>(p.y),
                           static_cast<double>(p.z));
  };
  // Images are floats, which are coarse far from the origin.
  const Eigen::Vector3d near = to_eigen(mesh.positions[mesh.indices.front()]);
  const auto image = [&](const glm::vec3& x, const glm::vec3& k) {
    const Eigen::Vector2d on_plane = plane.to_plane(to_eigen(x) - near).head<2>();
    const Eigen::Vector2d kernel = plane.to_plane(to_eigen(k) - near).head<2>();
    const Eigen::Vector2d p = kernel + factor * (on_plane - kernel);
    return PlanePoint{static_cast<float>(p.x()), static_cast<float>(p.y())};
  };
  std::vector<PlanePoint> images;
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    images.push_back(image(mesh.positions[i], kernels.kernels[i]));
  }
  std::vector<PlanePoint> triangles;
  Eigen::Vector2f low = Eigen::Vector2f::Constant(std::numeric_limits<float>::infinity());
  Eigen::Vector2f high = -low;
  for (const std::uint32_t index : mesh.indices) {
    const PlanePoint& p = images[index];
    triangles.push_back(p);
    low = low.cwiseMin(Eigen::Vector2f(p.u, p.v));
    high = high.cwiseMax(Eigen::Vector2f(p.u, p.v));
  }
  const Eigen::Vector2f size = high - low;
  const float cell = size.maxCoeff() / static_cast<float>(kCells);
  if (!(cell > 0.0F) || !std::isfinite(cell)) return 0.0;
  const auto cells = [cell](float length) { return static_cast<int>(length / cell) + 1; };
  Coverage layer(low, cell, cells(size.x()), cells(size.y()));
  Coverage outline = layer;
  layer.cover(triangles);
  const std::size_t covered = layer.count();
  const std::vector<SilhouettePoint> points = silhouette_points(mesh, kernels.up, kCells);
  if (covered == 0 || points.empty()) return 0.0;
  for (const SilhouettePoint& point : points) {
    // Its raster may be turned.
    const float half_side = 0.71F * static_cast<float>(factor) * point.side;
    outline.cover_square(image(point.place, point.kernel), half_side);
  }
  return 1.0 - static_cast<double>(layer.count_with(outline)) / static_cast<double>(covered);
}

}  // namespace penumbra
