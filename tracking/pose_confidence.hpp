// Assesses a measured pose: covariance, predicted overlay error, second pose of a planar target,
// and status (tracked or uncertain).
#pragma once

#include <limits>
#include <optional>
#include <vector>

#include "core/geometry/pose_estimate.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/detection/board_pose.hpp"
#include "tracking/motion/motion_blur.hpp"
#include "tracking/rigid_tags.hpp"

namespace penumbra {

// Maximum predicted overlay error of a tracked pose [px].
inline constexpr double kTrackedOverlay_px = 2.0;

// Pose measured in one frame, by detection or by alignment.
struct Measurement {
  RefinedPose best;
  std::optional<RefinedPose> second;  // second pose of a planar target
  BoardPose by_corners;               // source of `best` and `second` if they are not aligned
  bool by_ceres = false;              // by_corners was refined with Ceres
  double ambiguity_ratio = std::numeric_limits<double>::infinity();
  int tags_used = 0;
  std::vector<int> rejected;  // indices into RigidTags::tags
  bool ambiguous = false;     // the second pose may be the true one
  bool inconsistent = false;
  bool aligned = false;             // `best` is the result of an alignment
  double variance_inflation = 1.0;  // variance_inflation() of that alignment
  double map_px = 0.0;              // overlay error caused by errors of the map [px]
};

// Returns an alignment's pose with a covariance that is consistent for real images, or nullopt if
// the alignment is not verified. See docs/tracking.md#covariance.
[[nodiscard]] std::optional<RefinedPose> pose_of(const RigidTags& group, const Alignment& alignment,
                                                 const ImageMotion& motion);

// Sets the measurement's best pose to the alignment's pose.
void set_aligned_pose(const RigidTags& group, const Alignment& alignment, const RefinedPose& pose,
                      Measurement& measurement);

// Returns the factor by which the samples must increase for a predicted error below `budget_px`.
[[nodiscard]] double samples_needed(const CameraModel& camera, const AlignmentResult& result,
                                    double budget_px);

// Aligns the second pose of a few coplanar tags and compares its residuals with those of the first
// alignment's pose, measurement.best. Sets the measurement's second pose and ambiguity. Returns
// true if the second pose fits better; it is then measurement.best. See docs/tracking.md#two-poses.
bool add_second_pose(const RigidTags& group, const Alignment& first, const ImageMotion& motion,
                     Measurement& measurement);

struct AssessedPose {
  MapPoseEstimate estimate;
  bool only_lens_uncertain = false;  // uncertain only because of the lens
};

// Returns the estimate of a measured frame. If two poses fit, `predicted` selects the nearer pose.
[[nodiscard]] AssessedPose judge(const RigidTags& group, const Measurement& measurement,
                                 const std::optional<MapFromCamera>& predicted);

}  // namespace penumbra
