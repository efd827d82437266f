#include "render/shadow/projected/light_rays.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "render/model/to_eigen.hpp"
#include "render/scene/plane_outline.hpp"
#include "render/shadow/projected/projected_shadow.hpp"

namespace penumbra {
namespace {

// Vertices nearer to a marked vertex than this fraction of the model's size are the same corner.
constexpr double kSameCorner = 1e-4;

// Returns a colour distinct from those of adjacent indices: hues advance by the golden ratio.
glm::vec3 color_of(std::size_t index) {
  constexpr double kGolden = 0.61803398875;
  const double hue = 6.0 * std::fmod(0.02 + kGolden * static_cast<double>(index), 1.0);
  const auto channel = [hue](double middle) {
    const double away = std::abs(std::remainder(hue - middle, 6.0));
    return static_cast<float>(std::clamp(2.0 - away, 0.0, 1.0));
  };
  return {channel(0.0), channel(2.0), channel(4.0)};
}

// Returns the shadow of a point on the plane, or nullopt if it has no shadow on the plane.
std::optional<Eigen::Vector3d> shadow_on(const RayReceiver& plane, const Eigen::Vector4d& light,
                                         const Eigen::Vector3d& point) {
  const double height = light_height(plane.frame, light);
  if (!(height > 0.0)) return std::nullopt;
  const HeightRange range = hard_shadow_range(plane.frame, light);
  const Eigen::Vector3d p = plane.frame.to_plane(point);
  if (!(p.z() >= range.low && p.z() <= range.high)) return std::nullopt;
  const Eigen::Vector2d s = shadow_point(plane.frame, light, p);
  if (!s.allFinite() || (!plane.outline.empty() && !is_inside(s, plane.outline)))
    return std::nullopt;
  return plane.frame.lift(s.x(), s.y());
}

}  // namespace

std::vector<MarkedVertex> marked_vertices(const Model& model, std::size_t limit) {
  struct Candidate {
    MarkedVertex vertex;
    bool colored = false;
    // Squared distance to the nearest marked vertex.
    double nearest = std::numeric_limits<double>::infinity();
  };
  std::vector<Candidate> candidates;
  for (const Mesh& mesh : model.meshes) {
    const auto material = static_cast<std::size_t>(std::max(mesh.material, 0));
    const glm::vec3 base = material < model.materials.size()
                               ? glm::vec3(model.materials[material].base_color)
                               : glm::vec3(1.0F);
    for (const std::uint32_t i : mesh.indices) {
      Candidate& candidate = candidates.emplace_back();
      candidate.vertex.position = to_eigen(mesh.positions[i]);
      candidate.colored = i < mesh.colors.size();
      if (candidate.colored) candidate.vertex.color = base * glm::vec3(mesh.colors[i]);
    }
  }
  std::vector<MarkedVertex> marked;
  if (candidates.empty()) return marked;
  const Eigen::Vector3d low = to_eigen(model.min_corner);
  const Eigen::Vector3d high = to_eigen(model.max_corner);
  const double min_squared_distance = kSameCorner * kSameCorner * (high - low).squaredNorm();
  Eigen::Vector3d reference = 0.5 * (low + high);
  while (marked.size() < limit) {
    const bool first = marked.empty();
    const Candidate* farthest = nullptr;
    double farthest_away = first ? -1.0 : min_squared_distance;
    for (Candidate& candidate : candidates) {
      const double away = (candidate.vertex.position - reference).squaredNorm();
      if (!first) candidate.nearest = std::min(candidate.nearest, away);
      const double distance = first ? away : candidate.nearest;
      if (distance <= farthest_away) continue;
      farthest = &candidate;
      farthest_away = distance;
    }
    if (farthest == nullptr) break;
    reference = farthest->vertex.position;
    marked.push_back(farthest->vertex);
    if (!farthest->colored) marked.back().color = color_of(marked.size() - 1);
  }
  return marked;
}

std::vector<LightRay> light_rays(std::span<const MarkedVertex> vertices,
                                 const Placement& T_table_object, const Eigen::Vector4d& light,
                                 std::span<const RayReceiver> planes) {
  std::vector<LightRay> rays;
  if (!light.allFinite()) return rays;
  for (const MarkedVertex& marked : vertices) {
    const Eigen::Vector3d vertex = T_table_object * marked.position;
    if (!vertex.allFinite()) continue;
    std::optional<Eigen::Vector3d> shadow;
    for (const RayReceiver& plane : planes) {
      const auto candidate = shadow_on(plane, light, vertex);
      if (!candidate) continue;
      if (!shadow || (*candidate - vertex).squaredNorm() < (*shadow - vertex).squaredNorm()) {
        shadow = candidate;
      }
    }
    if (!shadow) continue;
    const Eigen::Vector3d from =
        light.w() != 0.0 ? Eigen::Vector3d(light.head<3>() / light.w())
                         : Eigen::Vector3d(vertex + kRayLength_m * light.head<3>().normalized());
    rays.push_back({from, vertex, *shadow, marked.color});
  }
  return rays;
}

}  // namespace penumbra
