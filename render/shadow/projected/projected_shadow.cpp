#include "render/shadow/projected/projected_shadow.hpp"

#include <algorithm>
#include <limits>

#include "render/shadow/layers/split_edges.hpp"

namespace penumbra {

namespace {

// Faces are clipped this fraction of the light's height below the light, so that shadows stay
// finite (Sudarsky's epsilon).
constexpr double kLightMargin = 1e-3;

// Returns the position or direction of the light in plane coordinates.
Eigen::Vector3d light_on_plane(const PlaneFrame& plane, const Eigen::Vector4d& light) {
  return light.w() != 0.0
             ? plane.to_plane(light.head<3>() / light.w())
             : Eigen::Vector3d(plane.e1.dot(light.head<3>()), plane.e2.dot(light.head<3>()),
                               plane.n.dot(light.head<3>()));
}

HeightRange range_below(const Eigen::Vector3d& to_light, bool is_point) {
  return {0.0,
          is_point ? to_light.z() * (1.0 - kLightMargin) : std::numeric_limits<double>::infinity()};
}

// Returns the shadow S = P + (P - L) d_P / (d_L - d_P) of P; exact for points on the plane.
Eigen::Vector2d project_from_light(const Eigen::Vector2d& p, double h,
                                   const Eigen::Vector3d& to_light, bool is_point) {
  return is_point ? Eigen::Vector2d(p + (p - to_light.head<2>()) * (h / (to_light.z() - h)))
                  : Eigen::Vector2d(p - to_light.head<2>() * (h / to_light.z()));
}

}  // namespace

double light_height(const PlaneFrame& plane, const Eigen::Vector4d& light) {
  return light_on_plane(plane, light).z();
}

HeightRange hard_shadow_range(const PlaneFrame& plane, const Eigen::Vector4d& light) {
  return range_below(light_on_plane(plane, light), light.w() != 0.0);
}

Eigen::Vector2d shadow_point(const PlaneFrame& plane, const Eigen::Vector4d& light,
                             const Eigen::Vector3d& point) {
  return project_from_light(point.head<2>(), point.z(), light_on_plane(plane, light),
                            light.w() != 0.0);
}

std::vector<PlanePoint> projected_triangles(std::span<const CasterVertex> vertices,
                                            std::span<const std::uint32_t> indices,
                                            const Eigen::Vector4d& light, const PlaneFrame& plane) {
  std::vector<PlanePoint> triangles;
  const bool is_point = light.w() != 0.0;
  const Eigen::Vector3d to_light = light_on_plane(plane, light);
  if (!to_light.allFinite() || to_light.z() <= 0.0) return triangles;
  const std::vector<CasterVertex> faces =
      clip_to_heights(vertices, indices, range_below(to_light, is_point));
  triangles.reserve(faces.size());
  for (const CasterVertex& vertex : faces) {
    const Eigen::Vector2d p(static_cast<double>(vertex.u), static_cast<double>(vertex.v));
    const Eigen::Vector2d s =
        project_from_light(p, static_cast<double>(vertex.h), to_light, is_point);
    triangles.push_back({static_cast<float>(s.x()), static_cast<float>(s.y())});
  }
  return triangles;
}

std::vector<PlanePoint> split_for_lens(const std::vector<PlanePoint>& triangles,
                                       const Eigen::Vector2d& centre, double longest_edge) {
  constexpr std::size_t kMaxTriangles = 200'000;
  constexpr double kDrawn_m = 30.0;  // triangles farther from the centre are not drawn
  const auto position = [](const PlanePoint& p) -> Eigen::Vector2d {
    return Eigen::Vector2f(p.u, p.v).cast<double>();
  };
  const auto middle = [](const PlanePoint& a, const PlanePoint& b) {
    return PlanePoint{0.5F * (a.u + b.u), 0.5F * (a.v + b.v)};
  };
  const auto too_far = [&](const PlanePoint& a, const PlanePoint& b, const PlanePoint& c) {
    const Eigen::Vector2d p = position(a);
    const double size = std::max((p - position(b)).norm(), (p - position(c)).norm());
    return (p - centre).norm() - size > kDrawn_m;
  };
  return split_within_budget(triangles, [&](double coarser) {
    const auto excess = [&](const PlanePoint& a, const PlanePoint& b) {
      const Eigen::Vector2d p = position(a);
      const Eigen::Vector2d q = position(b);
      const double distance = (0.5 * (p + q) - centre).norm();
      return (p - q).norm() /
             (coarser * std::max(longest_edge, kSplitShare * (distance - kSplitNear_m)));
    };
    return split_triangles(triangles, excess, middle, too_far, kMaxTriangles);
  });
}

}  // namespace penumbra
