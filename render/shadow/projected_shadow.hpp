// The hard shadow of a point or parallel light on a plane (Blinn, "Me and My (Fake) Shadow";
// Sudarsky, "Generating Dynamic Shadows for Virtual Reality Applications"; shadows.md 4 and 5),
// with exact clipping: every face is cut to the heights from which the light throws it onto the
// plane.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "render/shadow/layered_penumbra.hpp"
#include "render/shadow/plane_frame.hpp"

namespace penumbra {

// Homogeneous light (x, y, z, w): a place (w = 1) or the direction towards it (w = 0). A plane is
// the covector (n, -n.q); its product with a point or light is a signed height.
[[nodiscard]] Eigen::Vector4d plane_covector(const PlaneFrame& plane);

// M = (L.G) I - G L for row vectors, P' = P M.
[[nodiscard]] Eigen::Matrix4d shadow_matrix(const Eigen::Vector4d& light,
                                            const Eigen::Vector4d& plane);
// P M. w > 0 where light throws the point onto the plane; the sign matters, although it does not
// projectively.
[[nodiscard]] Eigen::Vector4d project_from_light(const Eigen::Vector4d& light,
                                                 const Eigen::Vector4d& plane,
                                                 const Eigen::Vector3d& point);

enum class ShadowOfPoint {
  shadow,             // on the plane or between it and the light
  at_or_above_light,  // an antishadow, or no shadow at all
  below_plane,        // a false shadow: matter that the light reaches only through the plane
};
// For a light above the plane.
[[nodiscard]] ShadowOfPoint classify_shadow(const Eigen::Vector4d& light,
                                            const Eigen::Vector4d& plane,
                                            const Eigen::Vector3d& point);

// Shadow triangles, three points each, in plane coordinates [m]. Kernels are not used. None where
// the light is in or under the plane. Faces that are not finite are left out.
[[nodiscard]] std::vector<PlanePoint> projected_triangles(std::span<const CasterVertex> vertices,
                                                          std::span<const std::uint32_t> indices,
                                                          const Eigen::Vector4d& light,
                                                          const PlaneFrame& plane);

}  // namespace penumbra
