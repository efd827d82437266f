// Camera pose from the corners of several tags. Rejects tags that are inconsistent with the
// others, and reports whether a second pose explains the view as well.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/transform.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

// Corners of one tag on the map and in the image.
struct TagObservation {
  int index = 0;                               // in the caller's list, as RigidTags::tags
  std::array<Eigen::Vector3d, 4> corners_map;  // [m]
  std::array<Eigen::Vector2d, 4> corners_px;
};

struct BoardPose {
  RefinedPose best;
  // The other minimum of a planar target; it fits worse.
  std::optional<RefinedPose> second;
  int tags_used = 0;
  std::vector<int> rejected;             // TagObservation::index of tags inconsistent with the rest
  std::vector<PointObservation> points;  // the corners that the poses fit
  // True if the tags are inconsistent with the map and no majority of them is right.
  bool inconsistent = false;
  // RMS of the second pose over that of the best; infinite without a second.
  [[nodiscard]] double ambiguity_ratio() const;
  // True if the second pose may be the true one: its RMS is less than `ratio` times that of the
  // best, or noise of the corners explains the difference.
  [[nodiscard]] bool is_ambiguous(double ratio) const;
};

// Fails, with a short reason, without usable tags and where the corners fix no pose.
[[nodiscard]] Result<BoardPose> estimate_board_pose(const CameraModel& camera,
                                                    std::span<const TagObservation> tags);

// Refines the poses by Ceres, from where this project's own solver has brought them.
void finish_by_ceres(const CameraModel& camera, BoardPose& pose);

}  // namespace penumbra
