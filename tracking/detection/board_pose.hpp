// Corners of several tags -> one camera pose: starts in closed form, refines the starts, rejects
// tags that contradict the others, and reports whether a second pose explains the view as well.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/transform.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

// One tag as it was seen: where its corners are on the table, and in the image.
struct TagObservation {
  int id = 0;                                    // the caller's; BoardPose::rejected returns it
  std::array<Eigen::Vector3d, 4> corners_table;  // [m]
  std::array<Eigen::Vector2d, 4> corners_px;
};

struct BoardPose {
  RefinedPose best;
  // The other minimum of a planar target, where there is one; it fits worse.
  std::optional<RefinedPose> second;
  int tags_used = 0;
  std::vector<int> rejected;             // TagObservation::id of those that contradict the rest
  std::vector<PointObservation> points;  // the corners that the poses fit
  // The tags contradict each other and no majority says which are right.
  bool contradictory = false;
  // RMS of the second over that of the best; infinite when there is no second.
  [[nodiscard]] double ambiguity_ratio() const;
  // Whether the second pose may be the true one: its RMS is less than `ratio` times that of the
  // best, or noise as corners of small tags have it would explain the difference.
  [[nodiscard]] bool is_ambiguous(double ratio) const;
};

// An error says in a few words why there is no pose: no usable tags, or corners that fix none.
[[nodiscard]] Result<BoardPose> estimate_board_pose(const CameraModel& camera,
                                                    std::span<const TagObservation> tags);

// Refines the poses by Ceres from where this project's own solver, which takes a twentieth of the
// time, has brought them.
void finish_by_ceres(const CameraModel& camera, BoardPose& pose);

}  // namespace penumbra
