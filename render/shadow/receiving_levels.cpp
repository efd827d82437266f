#include "render/shadow/receiving_levels.hpp"

#include <algorithm>
#include <array>
#include <limits>

#include "render/shadow/caster.hpp"
#include "render/to_eigen.hpp"

namespace penumbra {
namespace {

constexpr double kSameLevel = 5e-4;  // [m]
// A layer moves by the thickness of the caster times this over the light's height from one level to
// the next: less than a pixel.
constexpr double kStep = 4e-3;  // [m]
// Steeper faces get next to nothing of a light that comes straight down.
constexpr double kLeastCosine = 0.02;

}  // namespace

std::vector<double> receiving_levels(const Model& model, const Placement& T_table_object,
                                     const PlaneFrame& plane, std::size_t most) {
  const PlaneMap map = plane_map(T_table_object, plane);
  std::vector<double> levels;
  double sloped_low = std::numeric_limits<double>::infinity();
  double sloped_high = -sloped_low;
  for (const Mesh& mesh : model.meshes) {
    for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
      std::array<Eigen::Vector3d, 3> corners;
      for (std::size_t c = 0; c < 3; ++c) {
        corners[c] = map.linear * to_eigen(mesh.positions[mesh.indices[i + c]]) + map.offset;
      }
      const Eigen::Vector3d normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
      if (!(normal.z() > kLeastCosine * normal.norm())) continue;
      const auto [low, high] = std::minmax({corners[0].z(), corners[1].z(), corners[2].z()});
      if (!(high > 0.0)) continue;
      if (high - low <= kSameLevel) {
        levels.push_back(high);
      } else {
        sloped_low = std::min(sloped_low, std::max(low, 0.0));
        sloped_high = std::max(sloped_high, high);
      }
    }
  }
  if (levels.empty() && !(sloped_high > sloped_low)) return levels;
  double low = sloped_low;
  double high = sloped_high;
  for (const double level : levels) {
    low = std::min(low, level);
    high = std::max(high, level);
  }
  if (sloped_high > sloped_low) {
    const double step = std::max(kStep, (sloped_high - sloped_low) / static_cast<double>(most - 1));
    const auto steps = static_cast<int>((sloped_high - sloped_low) / step);
    for (int i = 0; i <= steps; ++i) levels.push_back(sloped_low + i * step);
    levels.push_back(sloped_high);
  }
  std::sort(levels.begin(), levels.end());
  // Of what is as good as level, the highest.
  std::vector<double> kept;
  for (const double level : levels) {
    if (!kept.empty() && level - kept.back() <= kSameLevel) {
      kept.back() = level;
    } else {
      kept.push_back(level);
    }
  }
  if (kept.size() <= most) return kept;
  kept.resize(most);
  for (std::size_t i = 0; i < most; ++i) {
    kept[i] = low + (high - low) * static_cast<double>(i) / static_cast<double>(most - 1);
  }
  return kept;
}

}  // namespace penumbra
