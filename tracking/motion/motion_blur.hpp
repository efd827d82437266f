// What the camera's motion during an exposure does to an aligned pose, and alignments that model
// that motion.
#pragma once

#include "core/image/frame.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/motion/pose_history.hpp"
#include "tracking/rigid_tags.hpp"

namespace penumbra {

// The longest blur through which tags are read, by libapriltag and by the alignment [cells].
inline constexpr double kDetectedBlur_cells = 2.0;
inline constexpr double kAlignedBlur_cells = 5.0;

// Image motion in a thirtieth of a second, RMS over the overlay cube.
struct ImageMotion {
  double predicted_px = 0.0;
  double missed_px = 0.0;  // what a prediction at constant velocity missed
  MotionBlurError blur;
};

// Overlay displacement in 1/30 s at this velocity, RMS [px].
[[nodiscard]] double image_motion_px(const CameraModel& camera, const CameraPose& pose,
                                     const Vector6d& velocity);

// The motion in a frame by its aligned pose and the poses before it, and what that motion hides of
// the pose. `longest_cells`: the longest blur that the method which found the pose reads.
[[nodiscard]] ImageMotion motion_found(const PoseHistory& history, const CameraModel& camera,
                                       const Frame& frame, const Alignment& alignment,
                                       double longest_cells);

// Aligns again where the motion that the aligned pose shows differs from the predicted one by so
// much that a rolling shutter or a known exposure matters.
void align_at_own_speed(const PoseHistory& history, const CameraModel& camera, const Frame& frame,
                        Alignment& alignment);

// Aligns a blurred frame again with tags that are blurred along its motion: by the exposure, or,
// where that is unknown, by as much of the frame interval as explains the image best. Keeps the
// pose of which the blur hides less; true where that is the new one. `blur`: what it hides.
[[nodiscard]] bool align_with_motion_blur(const PoseHistory& history, const CameraModel& camera,
                                          const Frame& frame, Alignment& alignment,
                                          MotionBlurError& blur);

}  // namespace penumbra
