#include "render/bounds.hpp"

#include <algorithm>
#include <limits>

#include "render/model/to_eigen.hpp"

namespace penumbra {

BoxCorners box_corners(const glm::vec3& low, const glm::vec3& high,
                       const Placement& T_table_object) {
  BoxCorners corners;
  for (unsigned i = 0; i < corners.size(); ++i) {
    corners[i] =
        T_table_object * to_eigen({((i & 1U) != 0U ? high : low).x, ((i & 2U) != 0U ? high : low).y,
                                   ((i & 4U) != 0U ? high : low).z});
  }
  return corners;
}

HeightRange heights_above(const PlaneFrame& plane, const BoxCorners& corners) {
  HeightRange range{std::numeric_limits<double>::infinity(),
                    -std::numeric_limits<double>::infinity()};
  for (const Eigen::Vector3d& corner : corners) {
    const double h = plane.height(corner);
    range.low = std::min(range.low, h);
    range.high = std::max(range.high, h);
  }
  return range;
}

Disc footprint(const BoxCorners& corners, const PlaneFrame& plane) {
  Disc disc;
  for (const Eigen::Vector3d& corner : corners)
    disc.centre += plane.to_plane(corner).head<2>() / 8.0;
  for (const Eigen::Vector3d& corner : corners)
    disc.radius = std::max(disc.radius, (plane.to_plane(corner).head<2>() - disc.centre).norm());
  return disc;
}

bool all_blends(const Model& model) {
  return std::ranges::all_of(model.meshes, [&model](const Mesh& mesh) {
    const auto at = static_cast<std::size_t>(mesh.material);
    return mesh.material >= 0 && at < model.materials.size() &&
           model.materials[at].alpha_mode == AlphaMode::blend;
  });
}

}  // namespace penumbra
