// The second pose that a planar target allows: a few tags in one plane, seen from afar, look the
// same from two poses but for perspective.
#pragma once

#include "tracking/measurement.hpp"
#include "tracking/motion/motion_blur.hpp"
#include "tracking/rigid_tags.hpp"

namespace penumbra {

// Aligns the other pose of the first alignment, whose pose is measurement.best, and lets the image
// decide which of the two it shows. Fills in the measurement's second pose and ambiguity; true
// where the image decides for the other pose, which is the best one then. The first alignment's
// result stays, the aligner's state does not. See docs/tracking.md#two-poses.
bool add_second_pose(const RigidTags& group, const Alignment& first, const ImageMotion& motion,
                     Measurement& measurement);

}  // namespace penumbra
