// The hard shadow of a point or parallel light on a plane (docs/shadows.md#projected-shadows).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "render/scene/plane_frame.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

// A light is homogeneous (x, y, z, w): a place (w = 1) or the direction towards it (w = 0).

// The light's height above the plane [m], or the third coordinate of its direction: > 0 where it
// throws shadows on it.
[[nodiscard]] double light_height(const PlaneFrame& plane, const Eigen::Vector4d& light);
// The heights from which the light throws shadows; faces are clipped to them.
[[nodiscard]] HeightRange hard_shadow_range(const PlaneFrame& plane, const Eigen::Vector4d& light);
// The shadow of a point (u, v, h) within that range.
[[nodiscard]] Eigen::Vector2d shadow_point(const PlaneFrame& plane, const Eigen::Vector4d& light,
                                           const Eigen::Vector3d& point);

// Shadow triangles, three points each, in plane coordinates [m]; kernels are not used. Empty where
// the light is in or under the plane. Faces that are not finite are ignored.
[[nodiscard]] std::vector<PlanePoint> projected_triangles(std::span<const CasterVertex> vertices,
                                                          std::span<const std::uint32_t> indices,
                                                          const Eigen::Vector4d& light,
                                                          const PlaneFrame& plane);

// Cuts triangles, three points each, so that straight edges can follow a lens: no edge is longer
// than `longest_edge` [m] near the table's origin (at `centre`), or than looks as short from there.
// Edges are cut alike in all of their triangles, and more coarsely where there would be over
// 200,000.
[[nodiscard]] std::vector<PlanePoint> split_for_lens(const std::vector<PlanePoint>& triangles,
                                                     const Eigen::Vector2d& centre,
                                                     double longest_edge);

}  // namespace penumbra
