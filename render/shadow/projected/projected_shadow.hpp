// Projects the hard shadow of a point or parallel light onto a plane
// (docs/shadows.md#projected-shadows).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "render/scene/plane_frame.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

// Lights are homogeneous (x, y, z, w): a position (w = 1) or the direction to the light (w = 0).
// Returns the light's height above the plane [m] or, if parallel, its direction's component along
// the normal. The light casts shadows on the plane if the result is > 0.
[[nodiscard]] double light_height(const PlaneFrame& plane, const Eigen::Vector4d& light);
// Returns the range of heights that cast shadows, to which faces are clipped.
[[nodiscard]] HeightRange hard_shadow_range(const PlaneFrame& plane, const Eigen::Vector4d& light);
// Returns the shadow of a point (u, v, h) within hard_shadow_range().
[[nodiscard]] Eigen::Vector2d shadow_point(const PlaneFrame& plane, const Eigen::Vector4d& light,
                                           const Eigen::Vector3d& point);

// Returns shadow triangles, three points each, in plane coordinates [m]; empty if the light is in
// or below the plane. Ignores kernels and non-finite faces.
[[nodiscard]] std::vector<PlanePoint> projected_triangles(std::span<const CasterVertex> vertices,
                                                          std::span<const std::uint32_t> indices,
                                                          const Eigen::Vector4d& light,
                                                          const PlaneFrame& plane);

// Splits triangles, three points each, so that they follow the lens distortion. Near the table's
// origin (at `centre`) no edge is longer than `longest_edge` [m]; farther edges may be longer
// (kSplitShare). All triangles at an edge share its midpoint. Splits more coarsely if there would
// be over 200,000 triangles.
[[nodiscard]] std::vector<PlanePoint> split_for_lens(const std::vector<PlanePoint>& triangles,
                                                     const Eigen::Vector2d& centre,
                                                     double longest_edge);

}  // namespace penumbra
