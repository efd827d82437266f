// Estimates the camera pose from the corners of several tags. Rejects tags that are inconsistent
// with the others, and reports a second pose that fits almost equally.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tracking_reasons.hpp"
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
  // The second minimum of a planar target, with a larger RMS.
  std::optional<RefinedPose> second;
  int tags_used = 0;
  std::vector<int> rejected;             // TagObservation::index of inconsistent tags
  std::vector<PointObservation> points;  // corners that the poses were fitted to
  // True if the tags are inconsistent with the map and no majority agrees with it.
  bool inconsistent = false;
  // Returns the RMS of the second pose divided by that of the best; infinite without a second.
  [[nodiscard]] double ambiguity_ratio() const;
  // Returns true if the second pose may be the true one: ambiguity_ratio() is below `ratio`, or
  // noise of the corners explains the difference.
  [[nodiscard]] bool is_ambiguous(double ratio) const;
};

// Fails with PoseCause::no_tag if there are no usable tags, and with PoseCause::undetermined if the
// corners do not determine a pose.
[[nodiscard]] tl::expected<BoardPose, PoseCause> estimate_board_pose(
    const CameraModel& camera, std::span<const TagObservation> tags);

// Refines the poses of estimate_board_pose() with Ceres.
void finish_by_ceres(const CameraModel& camera, BoardPose& pose);

}  // namespace penumbra
