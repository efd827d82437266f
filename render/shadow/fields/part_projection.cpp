#include "render/shadow/fields/part_projection.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "render/shadow/casters/index_groups.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMaxSides = 4000;  // larger cross-sections are skipped

struct SectionSide {
  double u0, v0, u1, v1;  // v0 < v1
  [[nodiscard]] double u_at(double v) const { return u0 + (v - v0) / (v1 - v0) * (u1 - u0); }
};

// Returns the intersection of an edge with the plane, the same for both faces at the edge.
Eigen::Vector2d crossing_of_plane(const CasterVertex& a, const CasterVertex& b) {
  const CasterVertex& from = b.h < 0.0F ? b : a;
  const CasterVertex& to = b.h < 0.0F ? a : b;
  const double t =
      static_cast<double>(from.h) / (static_cast<double>(from.h) - static_cast<double>(to.h));
  const auto between = [t](float low, float high) {
    return static_cast<double>(low) + t * (static_cast<double>(high) - static_cast<double>(low));
  };
  return {between(from.u, to.u), between(from.v, to.v)};
}

std::vector<SectionSide> section_sides(std::span<const CasterVertex> vertices,
                                       std::span<const std::uint32_t> faces) {
  std::vector<SectionSide> sides;
  for (std::size_t i = 0; i + 2 < faces.size(); i += 3) {
    std::array<Eigen::Vector2d, 2> ends;
    std::size_t count = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      const CasterVertex& a = vertices[faces[i + k]];
      const CasterVertex& b = vertices[faces[i + (k + 1) % 3]];
      // Corners in the plane count as above it.
      if ((a.h < 0.0F) != (b.h < 0.0F) && count < 2) ends[count++] = crossing_of_plane(a, b);
    }
    if (count < 2 || !ends[0].allFinite() || !ends[1].allFinite()) continue;
    if (ends[0].y() == ends[1].y()) continue;
    if (!(ends[0].y() < ends[1].y())) std::swap(ends[0], ends[1]);
    sides.push_back({ends[0].x(), ends[0].y(), ends[1].x(), ends[1].y()});
  }
  return sides;
}

// Returns triangles at height 0, three vertices each, that fill the plane's cross-section through a
// body that extends below it. The section is in shadow, but no face projects onto it.
std::vector<CasterVertex> section_of(std::span<const CasterVertex> vertices,
                                     std::span<const std::uint32_t> faces) {
  std::vector<CasterVertex> section;
  std::vector<SectionSide> sides = section_sides(vertices, faces);
  if (sides.size() > kMaxSides) return section;
  std::vector<double> levels;
  for (const SectionSide& side : sides) levels.insert(levels.end(), {side.v0, side.v1});
  std::ranges::sort(levels);
  levels.erase(std::unique(levels.begin(), levels.end()), levels.end());
  std::ranges::sort(sides, {}, &SectionSide::v0);
  const auto corner = [](const SectionSide* side, double v) {
    const auto x = static_cast<float>(side->u_at(v));
    const auto y = static_cast<float>(v);
    return CasterVertex{x, y, 0.0F, x, y};
  };
  std::vector<const SectionSide*> crossing;
  for (std::size_t i = 0; i + 1 < levels.size(); ++i) {
    // Sides don't cross between two levels, so consecutive pairs sorted by u bound trapezoids.
    const double low = levels[i];
    const double high = levels[i + 1];
    crossing.clear();
    for (const SectionSide& side : sides) {
      if (side.v0 > low) break;
      if (side.v1 >= high) crossing.push_back(&side);
    }
    if (crossing.size() % 2 != 0) continue;  // the surface is open
    const double middle = 0.5 * (low + high);
    std::ranges::sort(crossing, {},
                      [middle](const SectionSide* side) { return side->u_at(middle); });
    for (std::size_t k = 0; k + 1 < crossing.size(); k += 2) {
      const CasterVertex a = corner(crossing[k], low);
      const CasterVertex b = corner(crossing[k + 1], low);
      const CasterVertex c = corner(crossing[k + 1], high);
      const CasterVertex d = corner(crossing[k], high);
      section.insert(section.end(), {a, b, c, a, c, d});
    }
  }
  return section;
}

// Returns true if a vertex needs no clipping. Vertices at range.high are clipped too.
bool is_within(const CasterVertex& vertex, const HeightRange& range) {
  return std::isfinite(vertex.u) && std::isfinite(vertex.v) && std::isfinite(vertex.ku) &&
         std::isfinite(vertex.kv) && static_cast<double>(vertex.h) >= range.low &&
         static_cast<double>(vertex.h) < std::min(range.high, 1e30);
}

// Projects clipped corners from the light of one part.
class LightProjection {
 public:
  LightProjection(const LayeredConstants& constants, const PartLight& light)
      : light_height_(constants.light_height),
        centre_(light.centre),
        radius_(std::isinf(constants.light_height) ? light.radius / constants.umbra_height
                                                   : light.radius * constants.light_ratio) {}

  [[nodiscard]] FieldPoint operator()(const CasterVertex& vertex) const {
    const double h = static_cast<double>(vertex.h);
    const double t = std::isinf(light_height_) ? 0.0 : h / (light_height_ - h);
    const double du = static_cast<double>(vertex.u) - centre_.x();
    const double dv = static_cast<double>(vertex.v) - centre_.y();
    return {static_cast<float>(static_cast<double>(vertex.u) + t * du),
            static_cast<float>(static_cast<double>(vertex.v) + t * dv),
            static_cast<float>(radius_ * (std::isinf(light_height_) ? h : t))};
  }
  // Requires a finite light height.
  [[nodiscard]] float rho_at(double h) const {
    return static_cast<float>(radius_ * (h / (light_height_ - h)));
  }

 private:
  double light_height_;
  Eigen::Vector2d centre_;
  double radius_;  // zenith: r_part / h_u, factor on h; else a r_part, factor on t = h / (H - h)
};

}  // namespace

ProjectedParts project_parts(std::span<const CasterVertex> vertices,
                             std::span<const std::uint32_t> indices,
                             std::span<const std::uint32_t> part, std::span<const PartLight> lights,
                             const LayeredConstants& constants) {
  const HeightRange range = layer_height_range(constants, ShadowLayer::middle);
  const std::size_t vertex_count = std::min(vertices.size(), part.size());
  IndexGroups faces;  // the last group: faces without a light
  faces.sort(indices.size() / 3, lights.size() + 1, [&](std::size_t face) {
    const auto corners = indices.subspan(3 * face, 3);
    if (std::ranges::max(corners) >= vertex_count) return lights.size();
    return std::min<std::size_t>(part[corners[0]], lights.size());
  });
  ProjectedParts result;
  // Last part that used a vertex, and the vertex's point there: a vertex may be in several parts.
  std::vector<std::size_t> part_of(vertices.size(), lights.size());
  std::vector<std::uint32_t> point_of(vertices.size());
  std::vector<std::uint32_t> straddling;  // faces that cross a limit
  for (std::size_t p = 0; p < lights.size(); ++p) {
    const LightProjection project(constants, lights[p]);
    ProjectedPart projected_part;
    projected_part.begin = result.corners.size();
    double low = std::numeric_limits<double>::infinity();
    double high = -low;
    const auto add_point = [&](const CasterVertex& vertex) {
      const FieldPoint& point = result.points.emplace_back(project(vertex));
      low = std::min(low, static_cast<double>(vertex.h));
      high = std::max(high, static_cast<double>(vertex.h));
      const Eigen::Vector2f at(point.x, point.y);
      projected_part.corner_bounds.extend(at);
      projected_part.disc_bounds.extend(at - Eigen::Vector2f::Constant(point.rho));
      projected_part.disc_bounds.extend(at + Eigen::Vector2f::Constant(point.rho));
    };
    straddling.clear();
    for (const std::uint32_t index : faces[p]) {
      const auto face = indices.subspan(std::size_t{3} * index, 3);
      const bool inside = std::ranges::all_of(
          face, [&](std::uint32_t vertex) { return is_within(vertices[vertex], range); });
      if (!inside) {
        straddling.insert(straddling.end(), face.begin(), face.end());
        continue;
      }
      for (const std::uint32_t vertex : face) {
        if (part_of[vertex] != p) {
          part_of[vertex] = p;
          point_of[vertex] = static_cast<std::uint32_t>(result.points.size());
          add_point(vertices[vertex]);
        }
        result.corners.push_back(point_of[vertex]);
      }
    }
    for (const std::vector<CasterVertex>& more :
         {clip_to_heights(vertices, straddling, range), section_of(vertices, straddling)}) {
      for (const CasterVertex& corner : more) {
        result.corners.push_back(static_cast<std::uint32_t>(result.points.size()));
        add_point(corner);
      }
    }
    projected_part.end = result.corners.size();
    if (projected_part.end == projected_part.begin) continue;
    // No caster on a table is that large, and larger numbers would overflow.
    constexpr float kMaxReach = 1e12F;
    if (!(projected_part.disc_bounds.min().minCoeff() > -kMaxReach &&
          projected_part.disc_bounds.max().maxCoeff() < kMaxReach)) {
      result.corners.resize(projected_part.begin);
      continue;
    }
    // For a light at the zenith or a flat part, rho is the same at all levels.
    if (!std::isinf(constants.light_height) && high > low) {
      for (std::size_t i = 0; i < kClipFractions.size(); ++i)
        projected_part.levels[i] = project.rho_at(low + kClipFractions[i] * (high - low));
      projected_part.top = project.rho_at(high);
    }
    result.disc_bounds.extend(projected_part.disc_bounds);
    result.parts.push_back(projected_part);
  }
  return result;
}

}  // namespace penumbra
