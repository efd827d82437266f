#include "render/shadow/projected/projected_shadow.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "render/shadow/layers/split_edges.hpp"

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

namespace {

// In plane coordinates: a place, or a direction.
Eigen::Vector3d light_on_plane(const PlaneFrame& plane, const Eigen::Vector4d& light) {
  return light.w() != 0.0
             ? plane.to_plane(light.head<3>() / light.w())
             : Eigen::Vector3d(plane.e1.dot(light.head<3>()), plane.e2.dot(light.head<3>()),
                               plane.n.dot(light.head<3>()));
}

HeightRange range_below(const Eigen::Vector3d& to_light, bool local) {
  return {0.0,
          local ? to_light.z() * (1.0 - kLightMargin) : std::numeric_limits<double>::infinity()};
}

// S = P + (P - L) d_P / (d_L - d_P): exact for points on the plane.
Eigen::Vector2d thrown(const Eigen::Vector2d& p, double h, const Eigen::Vector3d& to_light,
                       bool local) {
  return local ? Eigen::Vector2d(p + (p - to_light.head<2>()) * (h / (to_light.z() - h)))
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
  return thrown(point.head<2>(), point.z(), light_on_plane(plane, light), light.w() != 0.0);
}

std::vector<PlanePoint> projected_triangles(std::span<const CasterVertex> vertices,
                                            std::span<const std::uint32_t> indices,
                                            const Eigen::Vector4d& light, const PlaneFrame& plane) {
  std::vector<PlanePoint> triangles;
  const bool local = light.w() != 0.0;
  const Eigen::Vector3d to_light = light_on_plane(plane, light);
  if (!to_light.allFinite() || to_light.z() <= 0.0) return triangles;
  const std::vector<CasterVertex> faces =
      clip_to_heights(vertices, indices, range_below(to_light, local));
  triangles.reserve(faces.size());
  for (const CasterVertex& vertex : faces) {
    const Eigen::Vector2d p(static_cast<double>(vertex.u), static_cast<double>(vertex.v));
    const Eigen::Vector2d s = thrown(p, static_cast<double>(vertex.h), to_light, local);
    triangles.push_back({static_cast<float>(s.x()), static_cast<float>(s.y())});
  }
  return triangles;
}

std::vector<PlanePoint> projected_triangles_as_printed(std::span<const CasterVertex> vertices,
                                                       std::span<const std::uint32_t> indices,
                                                       const Eigen::Vector4d& light,
                                                       const PlaneFrame& plane, double c) {
  const double top =
      light.w() != 0.0 ? light_on_plane(plane, light).z() : std::numeric_limits<double>::infinity();
  const auto good = [&](std::uint32_t i) { return static_cast<double>(vertices[i].h) < top; };
  std::vector<CasterVertex> replaced(vertices.begin(), vertices.end());
  std::vector<bool> usable(vertices.size());
  for (std::uint32_t i = 0; i < vertices.size(); ++i) usable[i] = good(i);
  for (std::size_t face = 0; face + 2 < indices.size(); face += 3) {
    for (std::size_t from = 0; from < 3; ++from) {
      const std::uint32_t i = indices[face + from];
      for (const std::size_t step : {1U, 2U}) {
        const std::uint32_t j = indices[face + (from + step) % 3];
        if (usable[i] || !good(j)) continue;
        const CasterVertex& bad = vertices[i];
        const CasterVertex& near = vertices[j];
        // From the bad vertex to Q, and on by c of the way to the neighbour.
        const double to_q = (static_cast<double>(bad.h) - top) /
                            (static_cast<double>(bad.h) - static_cast<double>(near.h));
        const auto t = static_cast<float>(to_q + c * (1.0 - to_q));
        replaced[i] = {bad.u + t * (near.u - bad.u), bad.v + t * (near.v - bad.v),
                       bad.h + t * (near.h - bad.h), 0.0F, 0.0F};
        usable[i] = true;
      }
    }
  }
  std::vector<std::uint32_t> kept;
  for (std::size_t face = 0; face + 2 < indices.size(); face += 3) {
    const auto corners = indices.subspan(face, 3);
    if (std::ranges::all_of(corners, [&](std::uint32_t i) { return usable[i]; })) {
      kept.insert(kept.end(), corners.begin(), corners.end());
    }
  }
  return projected_triangles(replaced, kept, light, plane);
}

std::vector<PlanePoint> split_for_lens(const std::vector<PlanePoint>& triangles,
                                       const Eigen::Vector2d& centre, double longest_edge,
                                       std::size_t max_triangles) {
  constexpr double kDrawn_m = 30.0;  // nothing is drawn of what is farther from the centre
  const auto place = [](const PlanePoint& p) {
    return Eigen::Vector2d(static_cast<double>(p.u), static_cast<double>(p.v));
  };
  const auto middle = [](const PlanePoint& a, const PlanePoint& b) {
    return PlanePoint{0.5F * (a.u + b.u), 0.5F * (a.v + b.v)};
  };
  const auto too_far = [&](const PlanePoint& a, const PlanePoint& b, const PlanePoint& c) {
    const Eigen::Vector2d p = place(a);
    const double reach = std::max((p - place(b)).norm(), (p - place(c)).norm());
    return (p - centre).norm() - reach > kDrawn_m;
  };
  return split_within_budget(triangles, [&](double coarser) {
    const auto excess = [&](const PlanePoint& a, const PlanePoint& b) {
      const Eigen::Vector2d p = place(a);
      const Eigen::Vector2d q = place(b);
      const double distance = (0.5 * (p + q) - centre).norm();
      return (p - q).norm() /
             (coarser * std::max(longest_edge, kSplitShare * (distance - kSplitNear_m)));
    };
    return split_triangles(triangles, excess, middle, too_far, max_triangles);
  });
}

}  // namespace penumbra
