// Pose errors caused by motion during an exposure, and alignments that model this motion.
#pragma once

#include <limits>

#include "core/image/frame.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/motion/pose_history.hpp"
#include "tracking/rigid_tags.hpp"

namespace penumbra {

inline constexpr double kDetectedBlur_cells = 2.0;  // maximum blur at which libapriltag reads tags
inline constexpr double kAlignedBlur_cells = 5.0;  // maximum blur at which the alignment reads tags

// Finds how far residuals exceed those of sharp images of the same sheet, camera and light.
class SharpResiduals {
 public:
  // Adds the residual of an image with little motion.
  void add(double rms_px);
  // Returns the part of the residual that sharp images do not have [px, RMS]; all of it until some
  // images have been added.
  [[nodiscard]] double excess_px(double rms_px) const;

 private:
  double smallest_px_ = std::numeric_limits<double>::infinity();
  int count_ = 0;
};

// Exposure time as a fraction of other times; upper limits if it is unknown.
struct ExposureFractions {
  double of_motion = 1.0;    // of 1/30 s
  double of_interval = 1.0;  // of the frame interval, at most 1
  bool known = false;
};
// `frame_interval_s`: 0 if unknown.
[[nodiscard]] ExposureFractions exposure_of(const Frame& frame, double frame_interval_s);

// Image motion in 1/30 s, RMS over the overlay cube.
struct ImageMotion {
  double predicted_px = 0.0;    // motion at the estimated velocity
  double unpredicted_px = 0.0;  // deviation from the prediction at constant velocity
  ExposureFractions exposure;
  MotionBlurError blur;
  SharpResiduals sharp;  // of earlier images

  // Returns the motion during the exposure, or its upper limit.
  [[nodiscard]] double longest_blur_px() const;
};

// Returns the overlay displacement in 1/30 s at this velocity, RMS [px].
[[nodiscard]] double image_motion_px(const CameraModel& camera, const MapFromCamera& pose,
                                     const Vector6d& velocity);

// Estimates the motion in a frame and the pose error caused by its blur. `longest_cells`: maximum
// blur that the method which measured the pose can read.
[[nodiscard]] ImageMotion estimate_motion(const PoseHistory& history, const CameraModel& camera,
                                          const Frame& frame, const Alignment& alignment,
                                          double longest_cells);

// Aligns again with the measured motion if it differs from the prediction and the camera has a
// rolling shutter or a known exposure time.
void align_with_measured_motion(const PoseHistory& history, const CameraModel& camera,
                                const Frame& frame, Alignment& alignment);

// Aligns a blurred frame again with a model of its motion during the exposure. If the exposure time
// is unknown, uses the fraction of the frame interval that explains the image best. Returns true,
// and keeps the new pose, if this reduces `blur`, the pose error caused by blur.
[[nodiscard]] bool align_with_motion_blur(const PoseHistory& history, const CameraModel& camera,
                                          const Frame& frame, Alignment& alignment,
                                          MotionBlurError& blur);

}  // namespace penumbra
