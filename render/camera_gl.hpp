// Converts the tracker's camera (double, Eigen; x right, y down, z forward) to OpenGL (float, GLM).
#pragma once

#include <Eigen/Core>
#include <glm/mat3x3.hpp>
#include <glm/mat4x3.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

inline constexpr double kNear = 0.02;  // [m]
inline constexpr double kFar = 20.0;   // [m]

// Uniforms of lens.glsl: camera frame -> clip coordinates. The framebuffer's first row is the
// image's top row; the image's corner u = v = -0.5 is NDC (-1, -1).
struct LensUniforms {
  glm::vec4 scale_offset{1.0F, 1.0F, 0.0F, 0.0F};
  glm::vec4 k_low{0.0F};
  glm::vec4 k_high{0.0F};
  int model = 0;  // 0: no distortion, else 1 + DistortionModel
  float max_radius = 1.0F;
  glm::vec2 depth{0.0F};
};
[[nodiscard]] LensUniforms make_lens(const CameraModel& camera);

[[nodiscard]] glm::vec3 to_gl(const Eigen::Vector3d& v);
[[nodiscard]] glm::mat3 to_gl(const Eigen::Matrix3d& m);

// Affine maps, composed in double and rounded to float once. Columns: mapped axes and origin.
[[nodiscard]] glm::mat4x3 to_gl(const Placement& placement);
[[nodiscard]] glm::mat4x3 camera_from_object(const CameraPose& T_table_camera,
                                             const Placement& T_table_object);
// Coordinates (u, v, h) of a plane -> camera frame.
[[nodiscard]] glm::mat4x3 camera_from_plane(const CameraPose& T_table_camera,
                                            const PlaneFrame& plane);
// Object frame -> coordinates (u, v, h) of a plane.
[[nodiscard]] glm::mat4x3 plane_from_object(const PlaneFrame& plane,
                                            const Placement& T_table_object);

// Returns v such that v . (x, y, 1) is the plane's 1 / z [1/m] at the undistorted normalised image
// point (x, y).
[[nodiscard]] glm::vec3 inverse_depth(const CameraPose& T_table_camera, const PlaneFrame& plane);

// Minimum camera distance for which geometry is tessellated [m]. At smaller distances, the tags are
// only partly in view.
inline constexpr double kNearestDistance = 0.15;
// Returns the maximum length of an edge drawn straight [m]: at kNearestDistance it is up to 32 px
// long and deviates from the distorted edge by about 0.1 px.
[[nodiscard]] double longest_edge(const CameraModel& camera);

// Image bounds in undistorted normalised coordinates, with a margin: no pixel is outside.
struct ViewFrustum {
  double x_min = 0.0, x_max = 0.0, y_min = 0.0, y_max = 0.0;

  // Returns true if the convex hull of the points (camera frame [m]) is certainly out of view.
  [[nodiscard]] bool misses(std::span<const Eigen::Vector3d> hull) const;
  // Clips a convex polygon (corners in order, camera frame [m]) to the view.
  [[nodiscard]] std::vector<Eigen::Vector3d> clipped_to_view(
      std::span<const Eigen::Vector3d> polygon) const;
};
[[nodiscard]] ViewFrustum make_frustum(const CameraModel& camera);

}  // namespace penumbra
