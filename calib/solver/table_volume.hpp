// What a calibration is worth over a table: how surely the corners of the overlay cube are drawn
// with this lens.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

// Standard deviations along the worst direction [px], of each corner of overlay_cube(), as the
// covariance of the lens makes them. The camera looks down on the cube by 45 degrees, from as near
// as all of it is in the picture.
struct TableVolumeUncertainty {
  CameraPose T_table_camera;
  double distance_m = 0.0;  // from the table's origin
  std::array<Eigen::Vector2d, 8> corners_px;
  std::array<double, 8> known_pose_px{};  // the pose known
  // The pose found with the same wrong lens, from the sheet of tags that lies under the cube (as
  // `penumbra target` prints it): what a session sees. Most of a wrong lens goes into the pose.
  std::array<double, 8> tracked_px{};

  [[nodiscard]] double largest_known_pose_px() const;
  [[nodiscard]] double largest_tracked_px() const;
};

// `covariance`: of the lens parameters, in the order of calib/solver/intrinsics_solver.hpp. Nothing
// where the lens shows the cube nowhere within 5 m.
[[nodiscard]] std::optional<TableVolumeUncertainty> table_volume_uncertainty(
    const CameraModel& camera, const Eigen::MatrixXd& covariance);

}  // namespace penumbra
