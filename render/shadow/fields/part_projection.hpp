// Clips a caster's faces and projects them from the light of each part. Internal to fields/.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "render/shadow/fields/power_distance.hpp"

namespace penumbra {

// Fractions of a part's height at which the part is clipped. Its umbra is the union of the umbras
// of the whole part and of the clipped parts (docs/shadows.md#fields).
inline constexpr std::array<double, 2> kClipFractions = {0.5, 0.02};

// A projected corner: its position on the plane, and the radius rho of the disc that the light
// casts through it.
struct FieldPoint {
  float x, y, rho;
};

struct ProjectedPart {
  std::size_t begin = 0, end = 0;     // into ProjectedParts::corners
  Eigen::AlignedBox2f corner_bounds;  // bounds of the projected corners
  Eigen::AlignedBox2f disc_bounds;    // bounds of the discs around the corners
  // rho at the two clip levels (< 0: no such level).
  std::array<float, kClipFractions.size()> levels = {-1.0F, -1.0F};
  float top = 0.0F;  // rho at the top of the part
};

// The faces of all parts, clipped and projected [m].
struct ProjectedParts {
  std::vector<FieldPoint> points;
  std::vector<std::uint32_t> corners;  // indices into points, three per face
  std::vector<ProjectedPart> parts;
  Eigen::AlignedBox2f disc_bounds;  // bounds of the discs of all parts
};

// Parameters as in power_distance_layers(). Skips parts that are empty or implausibly large.
[[nodiscard]] ProjectedParts project_parts(std::span<const CasterVertex> vertices,
                                           std::span<const std::uint32_t> indices,
                                           std::span<const std::uint32_t> part,
                                           std::span<const PartLight> lights,
                                           const LayeredConstants& constants);

}  // namespace penumbra
