#include "render/shadow/fields/fixed_light.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/assert.hpp"

namespace penumbra {

namespace {

struct DiscVertex {
  Eigen::Vector2d x;
  Eigen::Vector2d k;
  double h = 0.0;
  double radius = 0.0;
  double part_radius = 0.0;
  bool at_end = false;  // on the cut where the umbra has shrunk to its kernel
};

// How fast the light's edge wanders, per height: lambda times this is what the factor gains. The
// zenith limit replaces a / H by 1 / h_u.
double light_slope(const DiscVertex& vertex, const LayeredConstants& constants) {
  return vertex.part_radius / constants.umbra_height;  // R_L / H
}

// H R - R_L h over H: the umbra is where it is positive.
double umbra_left(const DiscVertex& vertex, const LayeredConstants& constants) {
  return vertex.radius - light_slope(vertex, constants) * vertex.h;
}

DiscVertex between(const DiscVertex& a, const DiscVertex& b, double t) {
  return {a.x + t * (b.x - a.x),
          a.k + t * (b.k - a.k),
          a.h + t * (b.h - a.h),
          a.radius + t * (b.radius - a.radius),
          a.part_radius + t * (b.part_radius - a.part_radius),
          false};
}

Eigen::Vector2d image_of(const DiscVertex& vertex, const LayeredConstants& constants,
                         ShadowLayer layer) {
  if (vertex.at_end) return vertex.k;
  if (vertex.radius <= 0.0) return vertex.x;
  // 1 / (1 - h / H), which is 1 in the zenith limit.
  const double growth = std::isinf(constants.light_height)
                            ? 1.0
                            : constants.light_height / (constants.light_height - vertex.h);
  const double own = light_slope(vertex, constants) * vertex.h / vertex.radius;
  return vertex.k + growth * (1.0 + lambda_of(layer) * own) * (vertex.x - vertex.k);
}

struct DiscFace {
  std::array<DiscVertex, 8> vertices;
  std::size_t count = 0;
  void add(const DiscVertex& vertex) { vertices[count++] = vertex; }
};

// Keeps where `value` is >= 0; the cut gets what `assign` says.
template <class Value, class Assign>
DiscFace clip(const DiscFace& face, Value value, Assign assign) {
  DiscFace clipped;
  for (std::size_t i = 0; i < face.count; ++i) {
    const DiscVertex& from = face.vertices[i];
    const DiscVertex& to = face.vertices[(i + 1) % face.count];
    const double a = value(from);
    const double b = value(to);
    if (a >= 0.0) clipped.add(from);
    if ((a >= 0.0) == (b >= 0.0) || a == 0.0 || b == 0.0) continue;
    // Always from the inner end, so that both faces of an edge get the same point.
    DiscVertex cut = a > 0.0 ? between(from, to, a / (a - b)) : between(to, from, b / (b - a));
    assign(cut);
    clipped.add(cut);
  }
  return clipped;
}

DiscVertex disc_vertex(const CasterVertex& vertex, const VertexDisc& disc) {
  return {{static_cast<double>(vertex.u), static_cast<double>(vertex.v)},
          {static_cast<double>(vertex.ku), static_cast<double>(vertex.kv)},
          static_cast<double>(vertex.h),
          static_cast<double>(disc.radius),
          static_cast<double>(disc.part_radius),
          false};
}

bool is_finite(const DiscVertex& vertex) {
  return vertex.x.allFinite() && vertex.k.allFinite() && std::isfinite(vertex.h) &&
         std::isfinite(vertex.radius) && std::isfinite(vertex.part_radius);
}

DiscFace clipped_face(const std::array<DiscVertex, 3>& corners, const LayeredConstants& constants,
                      ShadowLayer layer) {
  DiscFace face;
  for (const DiscVertex& corner : corners) face.add(corner);
  const double cap = layer_height_range(constants, ShadowLayer::penumbra).high;
  face = clip(
      face, [](const DiscVertex& v) { return v.h; }, [](DiscVertex& v) { v.h = 0.0; });
  if (std::isfinite(cap)) {
    face = clip(
        face, [cap](const DiscVertex& v) { return cap - v.h; },
        [cap](DiscVertex& v) { v.h = cap; });
  }
  if (layer == ShadowLayer::umbra) {
    face = clip(
        face, [&](const DiscVertex& v) { return umbra_left(v, constants); },
        [](DiscVertex& v) { v.at_end = true; });
  }
  return face;
}

double twice_area(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c) {
  const Eigen::Vector2d p = b - a;
  const Eigen::Vector2d q = c - a;
  return p.x() * q.y() - p.y() * q.x();
}

template <class Use>
void for_each_face(std::span<const CasterVertex> vertices, std::span<const VertexDisc> discs,
                   std::span<const std::uint32_t> indices, Use use) {
  PENUMBRA_ASSERT(discs.size() == vertices.size());
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    std::array<DiscVertex, 3> corners;
    bool usable = true;
    for (std::size_t j = 0; j < 3 && usable; ++j) {
      usable = indices[i + j] < vertices.size();
      if (!usable) break;
      corners[j] = disc_vertex(vertices[indices[i + j]], discs[indices[i + j]]);
      usable = is_finite(corners[j]);
    }
    if (usable) use(corners);
  }
}

}  // namespace

std::vector<VertexDisc> vertex_discs(const ShadowMesh& mesh, const ShadowKernels& kernels,
                                     std::span<const PartDisc> parts, double scale) {
  PENUMBRA_ASSERT(kernels.radius.size() == mesh.positions.size());
  PENUMBRA_ASSERT(parts.size() == mesh.part_count);
  std::vector<VertexDisc> discs(mesh.positions.size());
  for (std::size_t i = 0; i < discs.size(); ++i) {
    discs[i] = {static_cast<float>(scale * static_cast<double>(kernels.radius[i])),
                static_cast<float>(scale * static_cast<double>(parts[mesh.part[i]].radius))};
  }
  return discs;
}

std::optional<std::vector<PlanePoint>> fixed_light_images(std::span<const CasterVertex> vertices,
                                                          std::span<const VertexDisc> discs,
                                                          const LayeredConstants& constants,
                                                          ShadowLayer layer) {
  PENUMBRA_ASSERT(discs.size() == vertices.size());
  const double cap = layer_height_range(constants, ShadowLayer::penumbra).high;
  std::vector<PlanePoint> images;
  images.reserve(vertices.size());
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const DiscVertex vertex = disc_vertex(vertices[i], discs[i]);
    if (!is_finite(vertex) || vertex.h < 0.0 || vertex.h > cap) return std::nullopt;
    if (layer == ShadowLayer::umbra && umbra_left(vertex, constants) < 0.0) return std::nullopt;
    const Eigen::Vector2d p = image_of(vertex, constants, layer);
    images.push_back({static_cast<float>(p.x()), static_cast<float>(p.y())});
  }
  return images;
}

std::vector<PlanePoint> fixed_light_triangles(std::span<const CasterVertex> vertices,
                                              std::span<const VertexDisc> discs,
                                              std::span<const std::uint32_t> indices,
                                              const LayeredConstants& constants,
                                              ShadowLayer layer) {
  std::vector<PlanePoint> triangles;
  for_each_face(vertices, discs, indices, [&](const std::array<DiscVertex, 3>& corners) {
    const DiscFace face = clipped_face(corners, constants, layer);
    const auto point = [&](std::size_t i) -> PlanePoint {
      const Eigen::Vector2d p = image_of(face.vertices[i], constants, layer);
      return {static_cast<float>(p.x()), static_cast<float>(p.y())};
    };
    for (std::size_t i = 2; i < face.count; ++i) {
      triangles.insert(triangles.end(), {point(0), point(i - 1), point(i)});
    }
  });
  return triangles;
}

TwistReport fixed_light_twists(std::span<const CasterVertex> vertices,
                               std::span<const VertexDisc> discs,
                               std::span<const std::uint32_t> indices,
                               const LayeredConstants& constants) {
  // A face that is seen edge-on has no side to turn.
  constexpr double kEdgeOn = 1e-7;
  TwistReport report;
  double tested_area = 0.0;
  double twisted_area = 0.0;
  const auto turns = [&](const std::array<DiscVertex, 3>& corners) {
    for (const ShadowLayer layer : kShadowLayers) {
      const DiscFace face = clipped_face(corners, constants, layer);
      for (std::size_t i = 2; i < face.count; ++i) {
        const DiscVertex& a = face.vertices[0];
        const DiscVertex& b = face.vertices[i - 1];
        const DiscVertex& c = face.vertices[i];
        const double seen = twice_area(a.x, b.x, c.x);
        const double image =
            twice_area(image_of(a, constants, layer), image_of(b, constants, layer),
                       image_of(c, constants, layer));
        const double size = std::max((b.x - a.x).squaredNorm(), (c.x - a.x).squaredNorm());
        if (std::abs(seen) > kEdgeOn * size && seen * image < 0.0) return true;
      }
    }
    return false;
  };
  for_each_face(vertices, discs, indices, [&](const std::array<DiscVertex, 3>& corners) {
    const double area = std::abs(twice_area(corners[0].x, corners[1].x, corners[2].x));
    const double size = std::max((corners[1].x - corners[0].x).squaredNorm(),
                                 (corners[2].x - corners[0].x).squaredNorm());
    if (!(area > kEdgeOn * size)) return;
    ++report.faces_tested;
    tested_area += area;
    if (!turns(corners)) return;
    ++report.faces_twisted;
    twisted_area += area;
  });
  if (tested_area > 0.0) report.area_share = twisted_area / tested_area;
  return report;
}

}  // namespace penumbra
