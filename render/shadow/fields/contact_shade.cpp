#include "render/shadow/fields/contact_shade.hpp"

#include <algorithm>
#include <limits>

#include "core/assert.hpp"

namespace penumbra {

double contact_reach(double diagonal) {
  constexpr double kPerDiagonal = 0.08;
  constexpr double kMin_m = 0.002, kMax_m = 0.012;
  return std::clamp(kPerDiagonal * diagonal, kMin_m, kMax_m);
}

ShadowField contact_shade(std::span<const CasterVertex> vertices,
                          std::span<const std::uint32_t> indices, double reach,
                          const ShadowFieldOptions& options) {
  PENUMBRA_ASSERT(reach > 0.0);
  // Upside down, seen from the height `reach`, these are the discs of a light at the zenith. What
  // is below the plane touches it.
  std::vector<CasterVertex> turned(vertices.begin(), vertices.end());
  const auto height = static_cast<float>(reach);
  for (CasterVertex& vertex : turned) vertex.h = height - std::max(vertex.h, 0.0F);
  const std::vector<std::uint32_t> part(vertices.size(), 0);
  const PartLight light{Eigen::Vector2d::Zero(), reach};
  const auto constants =
      make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, reach);
  if (!constants) return {};
  return power_distance_layers(turned, indices, part, {&light, 1}, *constants, options);
}

}  // namespace penumbra
