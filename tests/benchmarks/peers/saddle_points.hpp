// A reference for a real video that no method under test has a part in: the points inside the tags
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
  int tag = 0;                                       // place in the list of tags
  Eigen::Vector3d in_tag = Eigen::Vector3d::Zero();  // tag frame [m]
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();   // as measured [px]
};

// Measured by the saddle of a quadric through the grey levels around (Lucchese and Mitra, 2002):
// blur, tone curves and bright paper leave it where it is. Searched for within 2 px of where
// `T_table_camera` puts it.
[[nodiscard]] std::vector<SaddlePoint> find_saddle_points(const CameraModel& camera,
                                                          std::span<const MappedTag> tags,
                                                          const CameraPose& T_table_camera,
                                                          ImageView image);

// Tags' places and poses of the camera that explain the points best, Cauchy's loss over 0.25 px:
// what covers a point leaves it behind. The tags lie in z = 0 and parallel, as they are printed
// (some have one such point alone); the first one stays where it is. The camera has no distortion.
// Returns the RMS of what the loss keeps (residuals under 1 px) [px].
double adjust(const CameraModel& camera, std::span<const std::vector<SaddlePoint>> points,
              std::vector<MappedTag>& tags, std::vector<CameraPose>& poses);

}  // namespace penumbra::peers
