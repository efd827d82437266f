// How far a measured pose can be trusted: its covariance, the predicted overlay error, and whether
// the pose counts as tracked.
#pragma once

#include <optional>
#include <string_view>

#include "core/geometry/pose_estimate.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/measurement.hpp"
#include "tracking/motion/motion_blur.hpp"
#include "tracking/rigid_tags.hpp"

namespace penumbra {

// Predicted overlay error up to which a pose counts as tracked [px].
inline constexpr double kTrackedOverlay_px = 2.0;

// PoseEstimate's reasons: two poses explain the tags equally well; the tags of the map agree with
// no pose, because the camera file or the map is wrong. kNotFitting is followed by the residual in
// parentheses.
inline constexpr std::string_view kTwoPoses = "two poses fit";
inline constexpr std::string_view kContradicting = "the tags contradict each other";
inline constexpr std::string_view kNotFitting = "the tags do not fit the map";

// An alignment's pose with a covariance that holds for real images; nothing where the alignment is
// not verified. See docs/tracking.md#covariance.
[[nodiscard]] std::optional<RefinedPose> pose_of(const RigidTags& group, const Alignment& alignment,
                                                 const ImageMotion& motion);

// Makes an alignment's pose the measurement's best one.
void take_alignment(const RigidTags& group, const Alignment& alignment, const RefinedPose& pose,
                    Measurement& measurement);

// Factor of samples that an alignment needs until the noise of its samples leaves a predicted
// overlay error below the budget. More samples reduce no other error.
[[nodiscard]] double samples_needed(const CameraModel& camera, const AlignmentResult& result,
                                    double budget_px);

struct JudgedPose {
  PoseEstimate estimate;
  bool only_lens_uncertain = false;  // uncertain for no other reason than the camera file
};

// The estimate of a measured frame. `predicted` chooses between two poses that both fit.
[[nodiscard]] JudgedPose judge(const RigidTags& group, const Measurement& measurement,
                               const std::optional<CameraPose>& predicted);

}  // namespace penumbra
