// Uncertainty of the overlay cube's corners caused by the lens.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

// Standard deviation of each corner of overlay_cube() along its worst direction [px]. The camera
// looks down at 45 degrees, from the smallest distance at which the whole cube is in the image.
struct TableVolumeUncertainty {
  CameraPose T_table_camera;
  double distance_m = 0.0;  // from the table's origin
  std::array<Eigen::Vector2d, 8> corners_px;
  std::array<double, 8> known_pose_px{};  // for a known pose
  // For a pose estimated with the same lens from the sheet of tags under the cube (as `penumbra
  // target` prints it). This pose compensates most of a lens error.
  std::array<double, 8> tracked_px{};

  [[nodiscard]] double largest_known_pose_px() const;
  [[nodiscard]] double largest_tracked_px() const;
};

// `covariance`: CalibrationSolution::covariance. Returns nullopt if the cube does not fit into the
// image from up to 5 m.
[[nodiscard]] std::optional<TableVolumeUncertainty> table_volume_uncertainty(
    const CameraModel& camera, const Eigen::MatrixXd& covariance);

}  // namespace penumbra
