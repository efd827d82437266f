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

// Returns poses with all points in front of the camera, best fit first: up to two for coplanar
// points (IPPE: Collins and Bartoli, IJCV 2014), one for other points (SQPnP: Terzakis and
// Lourakis, ECCV 2020), up to three for nearly coplanar points. Returns none for collinear points,
// numbers that are not finite, or fewer than 4 pixels that the lens model can unproject.
[[nodiscard]] std::vector<MapFromCamera> solve_pose(const CameraModel& camera,
                                                    std::span<const PointObservation> observations);

}  // namespace penumbra
