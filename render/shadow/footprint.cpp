#include "render/shadow/footprint.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace penumbra {

namespace {

// Covers the cells whose centres lie in the triangle (corners in cells, cell centres at + 0.5).
void cover_triangle(Footprint& footprint, const std::array<Eigen::Vector2d, 3>& corners) {
  const double low = std::min({corners[0].y(), corners[1].y(), corners[2].y()});
  const double high = std::max({corners[0].y(), corners[1].y(), corners[2].y()});
  const int first_row = std::max(0, static_cast<int>(std::ceil(low - 0.5)));
  const int last_row = std::min(footprint.height - 1, static_cast<int>(std::floor(high - 0.5)));
  for (int row = first_row; row <= last_row; ++row) {
    const double y = row + 0.5;
    double left = footprint.width;
    double right = 0.0;
    for (std::size_t i = 0; i < 3; ++i) {
      const Eigen::Vector2d& a = corners[i];
      const Eigen::Vector2d& b = corners[(i + 1) % 3];
      if ((a.y() < y && b.y() < y) || (a.y() > y && b.y() > y) || a.y() == b.y()) continue;
      const double x = a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x());
      left = std::min(left, x);
      right = std::max(right, x);
    }
    const int first = std::max(0, static_cast<int>(std::ceil(left - 0.5)));
    const int last = std::min(footprint.width - 1, static_cast<int>(std::floor(right - 0.5)));
    if (first > last) continue;
    const auto begin =
        footprint.covered.begin() + static_cast<std::ptrdiff_t>(row) * footprint.width;
    std::fill(begin + first, begin + last + 1, std::uint8_t{1});
  }
}

}  // namespace

Footprint rasterise_footprint(std::span<const Eigen::Vector2d> points,
                              std::span<const std::uint32_t> faces, int cells) {
  Footprint footprint;
  if (points.empty() || cells < 1) return footprint;
  Eigen::Vector2d low = points[0];
  Eigen::Vector2d high = points[0];
  for (const Eigen::Vector2d& point : points) {
    low = low.cwiseMin(point);
    high = high.cwiseMax(point);
  }
  const Eigen::Vector2d extent = high - low;
  footprint.cell = extent.maxCoeff() / cells;
  if (!(footprint.cell > 0.0) || !std::isfinite(footprint.cell)) return footprint;
  const auto cells_along = [&](double length) {
    return std::clamp(static_cast<int>(std::ceil(length / footprint.cell)), 1, cells) + 2;
  };
  footprint.width = cells_along(extent.x());
  footprint.height = cells_along(extent.y());
  // Centred, so that a symmetric silhouette gets a symmetric raster.
  footprint.origin = 0.5 * (low + high) -
                     0.5 * footprint.cell * Eigen::Vector2d(footprint.width, footprint.height);
  footprint.covered.assign(
      static_cast<std::size_t>(footprint.width) * static_cast<std::size_t>(footprint.height), 0);
  for (std::size_t i = 0; i + 2 < faces.size(); i += 3) {
    std::array<Eigen::Vector2d, 3> corners;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      corners[corner] = (points[faces[i + corner]] - footprint.origin) / footprint.cell;
    }
    cover_triangle(footprint, corners);
  }
  return footprint;
}

Eigen::Vector2d footprint_centroid(const Footprint& footprint,
                                   std::span<const Eigen::Vector2d> points) {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  std::size_t count = 0;
  for (int row = 0; row < footprint.height; ++row) {
    for (int column = 0; column < footprint.width; ++column) {
      if (footprint
              .covered[static_cast<std::size_t>(row) * static_cast<std::size_t>(footprint.width) +
                       static_cast<std::size_t>(column)] == 0) {
        continue;
      }
      sum += footprint.centre(column, row);
      ++count;
    }
  }
  if (count == 0) {
    for (const Eigen::Vector2d& point : points) sum += point;
    count = points.size();
  }
  return count == 0 ? Eigen::Vector2d(Eigen::Vector2d::Zero())
                    : Eigen::Vector2d(sum / static_cast<double>(count));
}

}  // namespace penumbra
