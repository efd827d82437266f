#include "render/shadow/kernels/twist.hpp"

#include <Eigen/Geometry>
#include <array>
#include <cmath>

#include "render/model/to_eigen.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/shadow/layers/coverage.hpp"

namespace penumbra {

namespace {

// A face is edge-on if twice its area, divided by the caster's squared extent, is less than this.
constexpr double kEdgeOn = 1e-7;

double signed_area(const std::array<Eigen::Vector2d, 3>& p) {
  const Eigen::Vector2d b = p[1] - p[0];
  const Eigen::Vector2d c = p[2] - p[0];
  return 0.5 * (b.x() * c.y() - b.y() * c.x());
}

}  // namespace

TwistReport find_twists(std::span<const CasterVertex> vertices,
                        std::span<const std::uint32_t> indices, double low, double high) {
  TwistReport report;
  Eigen::AlignedBox2d box;
  for (const CasterVertex& vertex : vertices) {
    const Eigen::Vector2d p(static_cast<double>(vertex.u), static_cast<double>(vertex.v));
    if (p.allFinite()) box.extend(p);
  }
  const double extent = box.sizes().maxCoeff();
  const double edge_on = kEdgeOn * extent * extent;

  double tested_area = 0.0;
  double twisted_area = 0.0;
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    const auto face = indices.subspan(i, 3);
    if (std::ranges::max(face) >= vertices.size()) continue;
    // Area of the face at factor s: A(s) = A_k + s B + s^2 A_d (docs/shadows.md#fold-overs).
    std::array<Eigen::Vector2d, 3> points;
    std::array<Eigen::Vector2d, 3> kernels;
    std::array<Eigen::Vector2d, 3> offsets;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const CasterVertex& vertex = vertices[face[corner]];
      points[corner] = {static_cast<double>(vertex.u), static_cast<double>(vertex.v)};
      kernels[corner] = {static_cast<double>(vertex.ku), static_cast<double>(vertex.kv)};
      offsets[corner] = points[corner] - kernels[corner];
    }
    const double area = signed_area(points);
    if (!(2.0 * std::abs(area) > edge_on)) continue;  // also if the area is NaN
    const double kernel_area = signed_area(kernels);
    const double offset_area = signed_area(offsets);
    const double mixed = area - kernel_area - offset_area;
    const auto turns_over = [&](double s) {
      return (kernel_area + s * (mixed + s * offset_area)) * area < 0.0;
    };
    bool twisted = turns_over(low) || turns_over(high);
    const double turning_point = -mixed / (2.0 * offset_area);
    if (turning_point > low && turning_point < high) {
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

double layer_overshoot(const ShadowMesh& mesh, const ShadowKernels& kernels, double factor) {
  constexpr int kCells = 192;
  if (mesh.indices.empty()) return 0.0;
  const PlaneFrame plane = PlaneFrame::make(kernels.up, Eigen::Vector3d::Zero());
  // Projections are floats, so coordinates are relative to a near point.
  const Eigen::Vector3d near = to_eigen(mesh.positions[mesh.indices.front()]);
  const auto image = [&](const glm::vec3& x, const glm::vec3& k) {
    const Eigen::Vector2d on_plane = plane.to_plane(to_eigen(x) - near).head<2>();
    const Eigen::Vector2d kernel = plane.to_plane(to_eigen(k) - near).head<2>();
    const Eigen::Vector2d p = kernel + factor * (on_plane - kernel);
    return PlanePoint{static_cast<float>(p.x()), static_cast<float>(p.y())};
  };
  std::vector<PlanePoint> images;
  for (std::size_t i = 0; i < mesh.positions.size(); ++i)
    images.push_back(image(mesh.positions[i], kernels.kernels[i]));
  std::vector<PlanePoint> triangles;
  for (const std::uint32_t index : mesh.indices) triangles.push_back(images[index]);
  const Eigen::AlignedBox2f box = bounds_of(triangles);
  const Eigen::Vector2f size = box.sizes();
  const float cell = size.maxCoeff() / static_cast<float>(kCells);
  if (!(cell > 0.0F) || !std::isfinite(cell)) return 0.0;
  const auto cells = [cell](float length) { return static_cast<int>(length / cell) + 1; };
  Coverage layer(box.min(), cell, cells(size.x()), cells(size.y()));
  Coverage outline = layer;
  layer.cover(triangles);
  const std::size_t covered = layer.count();
  const std::vector<SilhouettePoint> points = silhouette_points(mesh, kernels.up, kCells);
  if (covered == 0 || points.empty()) return 0.0;
  for (const SilhouettePoint& point : points) {
    // The raster of the points may be rotated by any angle.
    const float half_side = 0.71F * static_cast<float>(factor) * point.side;
    outline.cover_square(image(point.sample_point, point.kernel), half_side);
  }
  return 1.0 - static_cast<double>(layer.count_with(outline)) / static_cast<double>(covered);
}

}  // namespace penumbra
