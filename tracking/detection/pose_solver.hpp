// Closed-form camera poses from points of a map and their pixels, as start of the refinement.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

struct PointObservation {
  Eigen::Vector3d p_map;  // [m]
  Eigen::Vector2d pixel;  // [px]
};

// Poses that see all points from in front, closest fit first. Coplanar points have up to two (IPPE:
// Collins and Bartoli, IJCV 2014), other points one (SQPnP: Terzakis and Lourakis, ECCV 2020),
// nearly coplanar ones all three. None for points on a line, numbers that are not finite, or fewer
// than 4 pixels that the lens model can unproject.
[[nodiscard]] std::vector<MapFromCamera> solve_pose(const CameraModel& camera,
                                                    std::span<const PointObservation> observations);

}  // namespace penumbra
