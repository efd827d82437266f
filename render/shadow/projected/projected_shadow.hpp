// The hard shadow of a point or parallel light on a plane (Blinn, "Me and My (Fake) Shadow";
// Sudarsky, "Generating Dynamic Shadows for Virtual Reality Applications";
// docs/shadows.md#projected-shadows), with exact clipping: every face is cut to the heights from
// which the light throws it onto the plane.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "render/scene/plane_frame.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

// A light is homogeneous (x, y, z, w): a place (w = 1) or the direction towards it (w = 0).

// The light's height above the plane [m], or of a direction its third coordinate: > 0 where it
// throws shadows on it. The plane's point is subtracted first.
[[nodiscard]] double light_height(const PlaneFrame& plane, const Eigen::Vector4d& light);
// The heights from which the light throws shadows; faces are cut to it. Sudarsky's epsilon, 1e-3 of
// the light's height, keeps them finite.
[[nodiscard]] HeightRange hard_shadow_range(const PlaneFrame& plane, const Eigen::Vector4d& light);
// Where the light throws a point (u, v, h) within that range.
[[nodiscard]] Eigen::Vector2d shadow_point(const PlaneFrame& plane, const Eigen::Vector4d& light,
                                           const Eigen::Vector3d& point);

// Shadow triangles, three points each, in plane coordinates [m]. Kernels are not used. None where
// the light is in or under the plane. Faces that are not finite are left out.
[[nodiscard]] std::vector<PlanePoint> projected_triangles(std::span<const CasterVertex> vertices,
                                                          std::span<const std::uint32_t> indices,
                                                          const Eigen::Vector4d& light,
                                                          const PlaneFrame& plane);

// Triangles, three points each, cut into smaller ones, so that straight edges can follow a lens:
// no edge is longer than `longest_edge` [m], or than what looks as short from near the table's
// origin (at `centre`) where it is farther from it. Edges are cut alike in all of their triangles;
// where that takes more than `max_triangles`, all of them are cut more coarsely.
[[nodiscard]] std::vector<PlanePoint> split_for_lens(const std::vector<PlanePoint>& triangles,
                                                     const Eigen::Vector2d& centre,
                                                     double longest_edge,
                                                     std::size_t max_triangles = 200'000);

}  // namespace penumbra
