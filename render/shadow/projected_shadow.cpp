#include "render/shadow/projected_shadow.hpp"

#include <limits>

namespace penumbra {

namespace {

// Faces end this share of the light's height below the light, where shadows would be infinite.
constexpr double kLightMargin = 1e-3;

}  // namespace

Eigen::Vector4d plane_covector(const PlaneFrame& plane) {
  return {plane.n.x(), plane.n.y(), plane.n.z(), -plane.n.dot(plane.q)};
}

Eigen::Matrix4d shadow_matrix(const Eigen::Vector4d& light, const Eigen::Vector4d& plane) {
  return light.dot(plane) * Eigen::Matrix4d::Identity() - plane * light.transpose();
}

Eigen::Vector4d project_from_light(const Eigen::Vector4d& light, const Eigen::Vector4d& plane,
                                   const Eigen::Vector3d& point) {
  return (point.homogeneous().transpose() * shadow_matrix(light, plane)).transpose();
}

ShadowOfPoint classify_shadow(const Eigen::Vector4d& light, const Eigen::Vector4d& plane,
                              const Eigen::Vector3d& point) {
  const double d_light = plane.dot(light);
  const double d_point = plane.dot(point.homogeneous());
  // w = d_L w_P - d_P w_L; the light's side comes first, since under the plane w is positive too.
  if (d_light - d_point * light.w() <= 0.0) return ShadowOfPoint::at_or_above_light;
  return d_point < 0.0 ? ShadowOfPoint::below_plane : ShadowOfPoint::shadow;
}

std::vector<PlanePoint> projected_triangles(std::span<const CasterVertex> vertices,
                                            std::span<const std::uint32_t> indices,
                                            const Eigen::Vector4d& light, const PlaneFrame& plane) {
  std::vector<PlanePoint> triangles;
  const bool local = light.w() != 0.0;
  // The light in plane coordinates, a direction or a place; the plane's point is subtracted first.
  const Eigen::Vector3d to_light = local ? plane.to_plane(light.head<3>() / light.w())
                                         : plane.to_plane(light.head<3>() + plane.q);
  if (!to_light.allFinite() || to_light.z() <= 0.0) return triangles;
  const HeightRange range = {
      0.0, local ? to_light.z() * (1.0 - kLightMargin) : std::numeric_limits<double>::infinity()};
  const std::vector<CasterVertex> faces = clip_to_heights(vertices, indices, range);
  triangles.reserve(faces.size());
  for (const CasterVertex& vertex : faces) {
    const Eigen::Vector2d p(static_cast<double>(vertex.u), static_cast<double>(vertex.v));
    const double h = static_cast<double>(vertex.h);
    // S = P + (P - L) d_P / (d_L - d_P): exact for points on the plane.
    const Eigen::Vector2d s =
        local ? Eigen::Vector2d(p + (p - to_light.head<2>()) * (h / (to_light.z() - h)))
              : Eigen::Vector2d(p - to_light.head<2>() * (h / to_light.z()));
    triangles.push_back({static_cast<float>(s.x()), static_cast<float>(s.y())});
  }
  return triangles;
}

}  // namespace penumbra
