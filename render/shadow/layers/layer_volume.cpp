#include "render/shadow/layers/layer_volume.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <map>

#include "core/assert.hpp"

namespace penumbra {
namespace {

// Sideways a volume goes nowhere, and downwards as far as its plane: no sphere is needed.
constexpr double kNoReach = 1e6;  // [m]
// What stands on the plane, or right under a height where it is cut, is not cut by rounding [m].
constexpr double kRounding = 1e-6;

Eigen::Vector3d place_of(const CasterVertex& vertex, const LayeredConstants& constants,
                         ShadowLayer layer, const PlaneFrame& plane) {
  const PlanePoint image = project_to_layer(vertex, constants, layer);
  return plane.lift(static_cast<double>(image.u), static_cast<double>(image.v)) +
         static_cast<double>(vertex.h) * plane.n;
}

// Straight along the plane's normal, wherever one stands.
Eigen::Vector4d light_above(const PlaneFrame& plane) {
  return {plane.n.x(), plane.n.y(), plane.n.z(), 0.0};
}

}  // namespace

LayerVolumeCaster::LayerVolumeCaster(const ShadowMesh& mesh)
    : mesh_(&mesh), whole_(mesh), faces_of_parts_(mesh.part_count) {
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    std::vector<std::uint32_t>& faces = faces_of_parts_[mesh.part[mesh.indices[i]]];
    faces.insert(faces.end(), {mesh.indices[i], mesh.indices[i + 1], mesh.indices[i + 2]});
  }
}

ShadowVolume LayerVolumeCaster::volume(const CasterOverPlane& caster, ShadowLayer layer,
                                       const PlaneFrame& plane) const {
  if (caster.vertices.empty()) return {};
  PENUMBRA_ASSERT(caster.mesh == mesh_ && caster.vertices.size() == mesh_->positions.size());
  const HeightRange range = layer_height_range(caster.constants, layer);
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  for (const CasterVertex& vertex : caster.vertices) {
    if (!std::isfinite(vertex.h)) return {};
    low = std::min(low, static_cast<double>(vertex.h));
    high = std::max(high, static_cast<double>(vertex.h));
  }
  if (!(high >= range.low) || !(low <= range.high)) return {};
  const std::array floors = {plane};
  if (low >= range.low - kRounding && high <= range.high + kRounding) {
    std::vector<Eigen::Vector3d> points;
    points.reserve(caster.vertices.size());
    for (const CasterVertex& vertex : caster.vertices)
      points.push_back(place_of(vertex, caster.constants, layer, plane));
    return whole_.volume_at(points, light_above(plane), floors, kNoReach);
  }
  // Cut part by part: a stencil counts those that lie over one another in turn.
  ShadowMesh cut;
  std::vector<Eigen::Vector3d> points;
  std::map<std::array<float, 5>, std::uint32_t> known;
  for (const std::vector<std::uint32_t>& faces : faces_of_parts_) {
    known.clear();
    for (const CasterVertex& vertex : clip_to_heights(caster.vertices, faces, range)) {
      const auto [entry, is_new] =
          known.try_emplace({vertex.u, vertex.v, vertex.h, vertex.ku, vertex.kv},
                            static_cast<std::uint32_t>(points.size()));
      if (is_new) {
        points.push_back(place_of(vertex, caster.constants, layer, plane));
        cut.positions.emplace_back(points.back().x(), points.back().y(), points.back().z());
        cut.part.push_back(cut.part_count);
      }
      cut.indices.push_back(entry->second);
    }
    if (!known.empty()) ++cut.part_count;
  }
  return VolumeCaster(cut).volume_at(points, light_above(plane), floors, kNoReach);
}

}  // namespace penumbra
