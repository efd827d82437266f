// Transforms a shadow mesh and its kernels to plane coordinates, the input of the layers.
#pragma once

#include <span>
#include <vector>

#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/fields/power_distance.hpp"
#include "render/shadow/kernels/shadow_kernels.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

// Maps object coordinates p to plane coordinates (u, v, h) = linear * p + offset.
struct PlaneMap {
  Eigen::Matrix3d linear;
  Eigen::Vector3d offset;  // [m]
};
[[nodiscard]] PlaneMap plane_map(const Placement& T_world_object, const PlaneFrame& plane);

// Returns one vertex per position, in plane coordinates [m]; computed in double, stored in float.
[[nodiscard]] std::vector<CasterVertex> place_caster(const ShadowMesh& mesh,
                                                     const ShadowKernels& kernels,
                                                     const Placement& T_world_object,
                                                     const PlaneFrame& plane);

// Returns the light of each part in plane coordinates, for power_distance_layers().
[[nodiscard]] std::vector<PartLight> part_lights(std::span<const PartDisc> discs,
                                                 const Placement& T_world_object,
                                                 const PlaneFrame& plane);

// Returns the plane's normal in the object frame: the direction that kernels are made for.
[[nodiscard]] Eigen::Vector3d up_in_object(const Placement& T_world_object,
                                           const PlaneFrame& plane);

}  // namespace penumbra
