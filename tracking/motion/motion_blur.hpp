// Effect of motion during an exposure on an aligned pose, and alignments that model it.
#pragma once

#include "core/image/frame.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/motion/pose_history.hpp"
#include "tracking/rigid_tags.hpp"

namespace penumbra {

// Longest blur through which libapriltag and the alignment read tags [cells].
inline constexpr double kDetectedBlur_cells = 2.0;
inline constexpr double kAlignedBlur_cells = 5.0;

// Image motion in a thirtieth of a second, RMS over the overlay cube.
struct ImageMotion {
  double predicted_px = 0.0;
  double missed_px = 0.0;  // what a prediction at constant velocity missed
  MotionBlurError blur;
};

// Overlay displacement in 1/30 s at this velocity, RMS [px].
[[nodiscard]] double image_motion_px(const CameraModel& camera, const MapFromCamera& pose,
                                     const Vector6d& velocity);

// Motion in a frame and the pose error that it hides. `longest_cells`: the longest blur that the
// method which found the pose reads.
[[nodiscard]] ImageMotion motion_found(const PoseHistory& history, const CameraModel& camera,
                                       const Frame& frame, const Alignment& alignment,
                                       double longest_cells);

// Aligns again where the motion differs from the prediction and a rolling shutter or a known
// exposure matters.
void align_at_own_speed(const PoseHistory& history, const CameraModel& camera, const Frame& frame,
                        Alignment& alignment);

// Aligns a blurred frame again with a model of its motion: during the exposure, or, where that is
// unknown, the share of the frame interval that explains the image best. Returns true, and keeps
// the new pose, if the blur hides less of it. `blur`: the hidden error.
[[nodiscard]] bool align_with_motion_blur(const PoseHistory& history, const CameraModel& camera,
                                          const Frame& frame, Alignment& alignment,
                                          MotionBlurError& blur);

}  // namespace penumbra
