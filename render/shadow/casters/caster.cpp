#include "render/shadow/casters/caster.hpp"

#include "core/assert.hpp"
#include "render/model/to_eigen.hpp"

namespace penumbra {

PlaneMap plane_map(const Placement& T_world_object, const PlaneFrame& plane) {
  Eigen::Matrix3d R_plane_world;
  R_plane_world.row(0) = plane.e1;
  R_plane_world.row(1) = plane.e2;
  R_plane_world.row(2) = plane.n;
  return {T_world_object.scale * (R_plane_world * T_world_object.rotation.toRotationMatrix()),
          R_plane_world * (T_world_object.position - plane.q)};
}

std::vector<CasterVertex> place_caster(const ShadowMesh& mesh, const ShadowKernels& kernels,
                                       const Placement& T_world_object, const PlaneFrame& plane) {
  PENUMBRA_ASSERT(kernels.kernels.size() == mesh.positions.size());
  const PlaneMap map = plane_map(T_world_object, plane);
  const auto to_plane = [&](const glm::vec3& p) -> Eigen::Vector3d {
    return map.linear * to_eigen(p) + map.offset;
  };
  std::vector<CasterVertex> vertices;
  vertices.reserve(mesh.positions.size());
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const Eigen::Vector3f x = to_plane(mesh.positions[i]).cast<float>();
    const Eigen::Vector3f k = to_plane(kernels.kernels[i]).cast<float>();
    vertices.push_back({x.x(), x.y(), x.z(), k.x(), k.y()});
  }
  return vertices;
}

std::vector<PartLight> part_lights(std::span<const PartDisc> discs, const Placement& T_world_object,
                                   const PlaneFrame& plane) {
  const PlaneMap map = plane_map(T_world_object, plane);
  std::vector<PartLight> lights;
  lights.reserve(discs.size());
  for (const PartDisc& disc : discs) {
    const Eigen::Vector3d centre = map.linear * to_eigen(disc.centre) + map.offset;
    lights.push_back({centre.head<2>(), T_world_object.scale * static_cast<double>(disc.radius)});
  }
  return lights;
}

Eigen::Vector3d up_in_object(const Placement& T_world_object, const PlaneFrame& plane) {
  return T_world_object.rotation.conjugate() * plane.n;
}

}  // namespace penumbra
