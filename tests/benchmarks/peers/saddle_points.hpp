// A reference for real video that does not depend on the compared methods: the points inside tags
// where two white and two black cells meet.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/image_view.hpp"

namespace penumbra::peers {

struct SaddlePoint {
  int tag = 0;                                       // index in the list of tags
  Eigen::Vector3d in_tag = Eigen::Vector3d::Zero();  // tag frame [m]
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();   // measured [px]
};

// Finds the points as saddles of a quadric fitted to the surrounding grey levels (Lucchese and
// Mitra, 2002). Blur, camera response and bright paper do not shift a saddle. Searches within 2 px
// of the position predicted with `T_table_camera`.
[[nodiscard]] std::vector<SaddlePoint> find_saddle_points(const CameraModel& camera,
                                                          std::span<const MappedTag> tags,
                                                          const CameraPose& T_table_camera,
                                                          ImageView image);

// Adjusts tag poses and camera poses to the points. Cauchy's loss with a scale of 0.25 px rejects
// covered points. The first tag is fixed. The other tags stay in the plane z = 0, as printed,
// because some tags have only one such point. The camera must have no distortion. Returns the RMS
// of the inliers (residuals below 1 px) [px].
double adjust(const CameraModel& camera, std::span<const std::vector<SaddlePoint>> points,
              std::vector<MappedTag>& tags, std::vector<CameraPose>& poses);

}  // namespace penumbra::peers
