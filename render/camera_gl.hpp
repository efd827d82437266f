// The one seam between the camera of computer vision (double, Eigen; x right, y down, z forward)
// and OpenGL (float, GLM). Everything before it is double, everything after it float.
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

// Uniforms of lens.glsl: camera frame -> clip coordinates. The pixel whose CENTRE is (0, 0) is the
// first of the framebuffer's first row, so u = -0.5 is the left edge, NDC -1, and v = -0.5 the top
// one, NDC -1: the framebuffer's row 0 is the picture's top row.
struct LensUniforms {
  glm::vec4 scale_offset{1.0F, 1.0F, 0.0F, 0.0F};
  glm::vec4 k_low{0.0F};
  glm::vec4 k_high{0.0F};
  int model = 0;  // 0: no distortion, 1: plumb_bob, 2: rational, 3: fisheye
  float max_radius = 1.0F;
  glm::vec2 depth{0.0F};
};
[[nodiscard]] LensUniforms make_lens(const CameraModel& camera);

[[nodiscard]] glm::vec3 to_gl(const Eigen::Vector3d& v);
[[nodiscard]] glm::mat3 to_gl(const Eigen::Matrix3d& m);

// Affine maps, composed in double and rounded once. Columns: where x, y, z go, and the origin.
[[nodiscard]] glm::mat4x3 to_gl(const Placement& placement);
[[nodiscard]] glm::mat4x3 camera_from_object(const CameraPose& T_table_camera,
                                             const Placement& T_table_object);
// (u, v, h) on the plane -> camera frame.
[[nodiscard]] glm::mat4x3 camera_from_plane(const CameraPose& T_table_camera,
                                            const PlaneFrame& plane);
// Object frame -> (u, v, h).
[[nodiscard]] glm::mat4x3 plane_from_object(const PlaneFrame& plane,
                                            const Placement& T_table_object);

// Edges of what is drawn are straight in the picture where the lens would bend them. At most this
// long [m], they are off by no more than about 0.1 px and span at most 32 px, at the nearest
// distance expected (0.15 m), anywhere in the picture.
[[nodiscard]] double longest_edge(const CameraModel& camera);
inline constexpr double kNearestDistance =
    0.15;  // [m]; nearer, the sheet's tags are not seen whole

// What the picture can show, in undistorted normalised coordinates, with a margin: whatever lies
// outside of it cannot touch a pixel.
struct ViewFrustum {
  double x_min = 0.0, x_max = 0.0, y_min = 0.0, y_max = 0.0;

  // Whether the convex hull of the points (camera frame [m]) is certainly out of view.
  [[nodiscard]] bool misses(std::span<const Eigen::Vector3d> hull) const;
  // The corners of what of a convex polygon (camera frame [m], in order) may be in view; none where
  // nothing is.
  [[nodiscard]] std::vector<Eigen::Vector3d> part_in_view(
      std::span<const Eigen::Vector3d> polygon) const;
};
[[nodiscard]] ViewFrustum make_frustum(const CameraModel& camera);

}  // namespace penumbra
