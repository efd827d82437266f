#include "render/shadow/layers/receiving_levels.hpp"

#include <algorithm>
#include <array>
#include <limits>

#include "render/model/to_eigen.hpp"
#include "render/shadow/casters/caster.hpp"

namespace penumbra {
namespace {

constexpr double kMinCosine = 0.02;     // steeper faces receive little light from straight above
constexpr double kLevelCosine = 0.999;  // minimum cosine of a horizontal face
constexpr double kContact = 1e-4;       // lower faces touch or are below the plane: no level [m]

}  // namespace

ReceivingSurface::ReceivingSurface(const Model& model, const Placement& T_table_object,
                                   const PlaneFrame& plane) {
  const PlaneMap map = plane_map(T_table_object, plane);
  if (!map.linear.allFinite() || !map.offset.allFinite()) return;
  for (const Mesh& mesh : model.meshes) {
    for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
      std::array<Eigen::Vector3d, 3> corners;
      for (std::size_t c = 0; c < 3; ++c) {
        corners[c] = map.linear * to_eigen(mesh.positions[mesh.indices[i + c]]) + map.offset;
      }
      const Eigen::Vector3d normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
      const double length = normal.norm();
      if (!(std::abs(normal.z()) > kMinCosine * length)) continue;
      const Eigen::Vector3d low = corners[0].cwiseMin(corners[1]).cwiseMin(corners[2]);
      const Eigen::Vector3d high = corners[0].cwiseMax(corners[1]).cwiseMax(corners[2]);
      if (!(high.z() > kContact)) continue;
      const bool level =
          high.z() - low.z() <= kLevelWidth && std::abs(normal.z()) > kLevelCosine * length;
      faces_.push_back({static_cast<float>(low.x()), static_cast<float>(high.x()),
                        static_cast<float>(low.y()), static_cast<float>(high.y()),
                        static_cast<float>(std::max(low.z(), 0.0)), static_cast<float>(high.z()),
                        level});
      bounds_.extend(Eigen::Vector2d(low.head<2>()));
      bounds_.extend(Eigen::Vector2d(high.head<2>()));
    }
  }
}

bool ReceivingSurface::overlaps(const Face& face, const Eigen::AlignedBox2d& rectangle) {
  return static_cast<double>(face.u_high) >= rectangle.min().x() &&
         static_cast<double>(face.u_low) <= rectangle.max().x() &&
         static_cast<double>(face.v_high) >= rectangle.min().y() &&
         static_cast<double>(face.v_low) <= rectangle.max().y();
}

double ReceivingSurface::lowest(const Eigen::AlignedBox2d& rectangle) const {
  double lowest = std::numeric_limits<double>::infinity();
  for (const Face& face : faces_) {
    if (overlaps(face, rectangle)) lowest = std::min(lowest, static_cast<double>(face.low));
  }
  return lowest;
}

std::vector<double> ReceivingSurface::levels(const Eigen::AlignedBox2d& rectangle, double top,
                                             std::size_t limit, const LevelSpacing& spacing) const {
  std::vector<double> plateaus;
  double slope_low = std::numeric_limits<double>::infinity();
  double slope_high = -slope_low;
  for (const Face& face : faces_) {
    const auto low = static_cast<double>(face.low);
    if (!overlaps(face, rectangle) || low > top) continue;
    if (face.level) {
      plateaus.push_back(low);
    } else {
      slope_low = std::min(slope_low, low);
      slope_high = std::max(slope_high, std::min(static_cast<double>(face.high), top));
    }
  }
  std::sort(plateaus.begin(), plateaus.end());
  std::vector<double> levels;
  for (const double height : plateaus) {
    if (levels.empty() || height - levels.back() > kLevelWidth) levels.push_back(height);
  }
  if (slope_high >= slope_low) {
    const std::size_t flat = levels.size();
    // Adds evenly spaced levels from `low` to `high`, both included.
    const auto add = [&](double low, double high, double step) {
      const double range = high - low;
      const double steps = std::clamp(std::ceil(range / step), 1.0, static_cast<double>(limit - 1));
      for (int i = 0; i <= static_cast<int>(steps); ++i) {
        const double height = low + range * i / steps;
        const auto near = [height](double plateau) {
          return std::abs(plateau - height) <= kLevelWidth;
        };
        if (std::none_of(levels.begin(), levels.begin() + static_cast<std::ptrdiff_t>(flat), near))
          levels.push_back(height);
      }
    };
    const double middle = std::clamp(spacing.clear_below, slope_low, slope_high);
    if (middle > slope_low) add(slope_low, middle, spacing.clear_step);
    if (slope_high > middle || middle == slope_low) add(middle, slope_high, spacing.step);
    std::sort(levels.begin(), levels.end());
    levels.erase(std::unique(levels.begin(), levels.end()), levels.end());
  }
  if (levels.size() <= limit) return levels;
  const double low = levels.front();
  const double high = levels.back();
  levels.resize(limit);
  for (std::size_t i = 0; i < limit; ++i) {
    levels[i] = low + (high - low) * static_cast<double>(i) / static_cast<double>(limit - 1);
  }
  return levels;
}

}  // namespace penumbra
