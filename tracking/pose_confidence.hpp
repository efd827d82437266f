// Confidence in a measured pose: covariance, predicted overlay error, the second pose of a planar
// target, and whether the pose counts as tracked.
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

// Predicted overlay error up to which a pose counts as tracked [px].
inline constexpr double kTrackedOverlay_px = 2.0;

// Pose measured in one frame, by detection or by alignment.
struct Measurement {
  RefinedPose best;
  std::optional<RefinedPose> second;  // the other pose of a planar target
  BoardPose by_corners;               // source of `best` and `second` where they are not aligned
  bool by_ceres = false;              // Ceres refined that
  double ambiguity_ratio = std::numeric_limits<double>::infinity();
  int tags_used = 0;
  std::vector<int> rejected;  // indices into RigidTags::tags
  bool ambiguous = false;     // the second pose may be the true one
  bool inconsistent = false;
  bool aligned = false;             // found by an alignment
  double variance_inflation = 1.0;  // of that alignment; see the function of this name
  double map_px = 0.0;              // overlay error by a map that the tags do not fit [px]
};

// An alignment's pose with a covariance that holds for real images; nothing where the alignment is
// not verified. See docs/tracking.md#covariance.
[[nodiscard]] std::optional<RefinedPose> pose_of(const RigidTags& group, const Alignment& alignment,
                                                 const ImageMotion& motion);

// Makes an alignment's pose the measurement's best one.
void take_alignment(const RigidTags& group, const Alignment& alignment, const RefinedPose& pose,
                    Measurement& measurement);

// Factor of samples that an alignment needs for a predicted overlay error below the budget.
[[nodiscard]] double samples_needed(const CameraModel& camera, const AlignmentResult& result,
                                    double budget_px);

// Aligns the second pose of a few coplanar tags, and lets the image decide between it and the
// first alignment's pose, measurement.best. Sets the measurement's second pose and ambiguity.
// Returns true if the image decides for the second, which is `best` then. See
// docs/tracking.md#two-poses.
bool add_second_pose(const RigidTags& group, const Alignment& first, const ImageMotion& motion,
                     Measurement& measurement);

struct JudgedPose {
  MapPoseEstimate estimate;
  bool only_lens_uncertain = false;  // uncertain only because of the lens
};

// The estimate of a measured frame. `predicted` chooses between two poses that both fit.
[[nodiscard]] JudgedPose judge(const RigidTags& group, const Measurement& measurement,
                               const std::optional<MapFromCamera>& predicted);

}  // namespace penumbra
