#include "render/shadow/fields/fixed_light.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/assert.hpp"

namespace penumbra {

namespace {

struct DiscVertex {
  Eigen::Vector2d x, k;
  double h = 0.0, radius = 0.0, part_radius = 0.0;
  bool at_end = false;  // on the clip line where the umbra has shrunk to its kernel
};

// Returns R_L / H: the numerator of s_lambda(h), divided by H, is 1 + lambda (R_L / H) h / R.
double light_slope(const DiscVertex& vertex, const LayeredConstants& constants) {
  return vertex.part_radius / constants.umbra_height;
}

// Returns (H R - R_L h) / H, which is positive at heights where the vertex has an umbra.
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

Eigen::Vector2d disc_image(const DiscVertex& vertex, const LayeredConstants& constants,
                           ShadowLayer layer) {
  if (vertex.at_end) return vertex.k;
  if (vertex.radius <= 0.0) return vertex.x;
  // 1 / (1 - h / H), which is 1 in the zenith limit.
  const double growth = std::isinf(constants.light_height)
                            ? 1.0
                            : constants.light_height / (constants.light_height - vertex.h);
  const double disc_growth = light_slope(vertex, constants) * vertex.h / vertex.radius;
  return vertex.k + growth * (1.0 + lambda_of(layer) * disc_growth) * (vertex.x - vertex.k);
}

struct DiscFace {
  std::array<DiscVertex, 8> vertices;
  std::size_t count = 0;
  void add(const DiscVertex& vertex) { vertices[count++] = vertex; }
};

// Clips a face to value(vertex) >= 0; assign(vertex) completes new vertices.
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
    // Interpolates from the inner end, so that both faces at an edge get the same point.
    DiscVertex cut = a > 0.0 ? between(from, to, a / (a - b)) : between(to, from, b / (b - a));
    assign(cut);
    clipped.add(cut);
  }
  return clipped;
}

DiscVertex disc_vertex(const CasterVertex& vertex, const VertexDisc& disc) {
  return {Eigen::Vector2f(vertex.u, vertex.v).cast<double>(),
          Eigen::Vector2f(vertex.ku, vertex.kv).cast<double>(),
          static_cast<double>(vertex.h),
          static_cast<double>(disc.radius),
          static_cast<double>(disc.part_radius),
          false};
}

bool is_finite_disc(const DiscVertex& vertex) {
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

PlanePoint to_point(const Eigen::Vector2d& p) {
  return {static_cast<float>(p.x()), static_cast<float>(p.y())};
}

// Returns true for a face seen edge-on, which cannot fold over.
bool is_edge_on(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c) {
  constexpr double kEdgeOnArea = 1e-7;
  const double size = std::max((b - a).squaredNorm(), (c - a).squaredNorm());
  return !(std::abs(twice_area(a, b, c)) > kEdgeOnArea * size);
}

bool folds_over(const std::array<DiscVertex, 3>& corners, const LayeredConstants& constants) {
  for (const ShadowLayer layer : kShadowLayers) {
    const DiscFace face = clipped_face(corners, constants, layer);
    for (std::size_t i = 2; i < face.count; ++i) {
      const DiscVertex& a = face.vertices[0];
      const DiscVertex& b = face.vertices[i - 1];
      const DiscVertex& c = face.vertices[i];
      const double image =
          twice_area(disc_image(a, constants, layer), disc_image(b, constants, layer),
                     disc_image(c, constants, layer));
      if (!is_edge_on(a.x, b.x, c.x) && twice_area(a.x, b.x, c.x) * image < 0.0) return true;
    }
  }
  return false;
}

template <class Use>
void for_each_face(std::span<const CasterVertex> vertices, std::span<const VertexDisc> discs,
                   std::span<const std::uint32_t> indices, Use use) {
  PENUMBRA_ASSERT(discs.size() == vertices.size());
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    const auto face = indices.subspan(i, 3);
    if (std::ranges::max(face) >= vertices.size()) continue;
    std::array<DiscVertex, 3> corners;
    for (std::size_t j = 0; j < 3; ++j) corners[j] = disc_vertex(vertices[face[j]], discs[face[j]]);
    if (std::ranges::all_of(corners, is_finite_disc)) use(corners);
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
    if (!is_finite_disc(vertex) || vertex.h < 0.0 || vertex.h > cap) return std::nullopt;
    if (layer == ShadowLayer::umbra && umbra_left(vertex, constants) < 0.0) return std::nullopt;
    images.push_back(to_point(disc_image(vertex, constants, layer)));
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
    const auto point = [&](std::size_t i) {
      return to_point(disc_image(face.vertices[i], constants, layer));
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
  TwistReport report;
  double tested_area = 0.0;
  double twisted_area = 0.0;
  for_each_face(vertices, discs, indices, [&](const std::array<DiscVertex, 3>& corners) {
    const double area = std::abs(twice_area(corners[0].x, corners[1].x, corners[2].x));
    if (is_edge_on(corners[0].x, corners[1].x, corners[2].x)) return;
    ++report.faces_tested;
    tested_area += area;
    if (!folds_over(corners, constants)) return;
    ++report.faces_twisted;
    twisted_area += area;
  });
  if (tested_area > 0.0) report.area_share = twisted_area / tested_area;
  return report;
}

}  // namespace penumbra
