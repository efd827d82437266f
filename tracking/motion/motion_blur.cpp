#include "tracking/motion/motion_blur.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "core/evaluation/evaluation.hpp"

namespace penumbra {
namespace {

constexpr double kMotionInterval_s = 1.0 / 30.0;
// With a longer interval, frames were probably dropped rather than exposed longer.
constexpr double kMaxExposure_s = 1.0 / 30.0;
// Assumed image motion of a frame without an earlier pose [px].
constexpr double kUnknownMotion_px = 5.0;

double moved_px(const CameraModel& camera, const MapFromCamera& pose, const Vector6d& xi) {
  return overlay_difference(camera, perturbed(pose, xi), pose).rms_px();
}

}  // namespace

void SharpResiduals::add(double rms_px) {
  if (!(rms_px > 0.0)) return;
  smallest_px_ = std::min(smallest_px_, rms_px);
  ++count_;
}

double SharpResiduals::excess_px(double rms_px) const {
  constexpr int kEnough = 8;
  constexpr double kScatter = 1.2;  // usual residual of a sharp image over the smallest
  if (count_ < kEnough || std::isnan(rms_px)) return rms_px;
  const double sharp_px = kScatter * smallest_px_;
  return rms_px > sharp_px ? std::sqrt(rms_px * rms_px - sharp_px * sharp_px) : 0.0;
}

ExposureFractions exposure_of(const Frame& frame, double frame_interval_s) {
  const double interval_s = frame_interval_s > 0.0 ? frame_interval_s : kMaxExposure_s;
  const double exposure_s = frame.exposure_s.value_or(std::min(interval_s, kMaxExposure_s));
  ExposureFractions fractions;
  fractions.of_motion = exposure_s / kMotionInterval_s;
  fractions.of_interval = std::min(exposure_s / interval_s, 1.0);
  fractions.known = frame.exposure_s.has_value();
  return fractions;
}

double ImageMotion::longest_blur_px() const {
  return exposure.of_motion * std::hypot(predicted_px, unpredicted_px);
}

double image_motion_px(const CameraModel& camera, const MapFromCamera& pose,
                       const Vector6d& velocity) {
  return moved_px(camera, pose, kMotionInterval_s * velocity);
}

ImageMotion estimate_motion(const PoseHistory& history, const CameraModel& camera,
                            const Frame& frame, const Alignment& alignment, double longest_cells) {
  const AlignmentResult& result = alignment.result;
  ImageMotion found{
      kUnknownMotion_px, kUnknownMotion_px, exposure_of(frame, history.frame_interval_s()), {}, {}};
  if (!result.verified) return found;
  const auto motion = history.motion_at(frame.timestamp_ns, result.T_map_camera);
  if (!motion) {
    found.blur = alignment.aligner.motion_blur_error(std::nullopt, false, longest_cells);
    return found;
  }
  const double interval_s = history.frame_interval_s();
  const double exposure_s =
      std::min(frame.exposure_s.value_or(std::min(interval_s, kMaxExposure_s)), interval_s);
  // If only two poses give the motion, blur in other directions may have displaced one of them.
  if (exposure_s > 0.0)
    found.blur = alignment.aligner.motion_blur_error(exposure_s * motion->velocity,
                                                     frame.exposure_s.has_value(),
                                                     motion->of_one_step ? longest_cells : 0.0);
  // Motion between two sharp images is not motion during their exposures.
  if (!(found.blur.shift_px > 0.0)) return found;
  found.predicted_px =
      std::max(found.predicted_px, image_motion_px(camera, result.T_map_camera, motion->velocity));
  found.unpredicted_px =
      std::max(found.unpredicted_px, image_motion_px(camera, result.T_map_camera, motion->change));
  return found;
}

void align_with_measured_motion(const PoseHistory& history, const CameraModel& camera,
                                const Frame& frame, Alignment& alignment) {
  AlignmentInput& input = alignment.input;
  AlignmentResult& result = alignment.result;
  const double half_readout_s =
      0.5 * camera.parameters().rolling_shutter_row_s.value_or(0.0) * (camera.height() - 1);
  // Blur and tilt of a single tag look alike.
  const double exposure_s = result.tags_verified > 1 ? frame.exposure_s.value_or(0.0) : 0.0;
  if (!(half_readout_s > 0.0) && !(exposure_s > 0.0)) return;
  constexpr double kElsewhere_px = 0.1;  // minimum displacement of rows that is corrected
  constexpr double kBlurred_px = 2.0;    // minimum error of the blur that is corrected
  // Maximum relative change of a motion whose blur is modelled; see docs/tracking.md#motion-blur.
  constexpr double kEvenly = 0.25;
  constexpr int kTries = 2;
  for (int i = 0; i < kTries && result.verified; ++i) {
    const auto found = history.motion_at(frame.timestamp_ns, result.T_map_camera);
    if (!found) return;
    const Vector6d velocity = result.velocity ? result.velocity->velocity : found->velocity;
    const auto apart_px = [&](const Vector6d& xi) {
      return moved_px(camera, result.T_map_camera, xi);
    };
    const Vector6d exposure_motion = exposure_s * velocity;
    const bool elsewhere = half_readout_s > 0.0 && !result.velocity &&
                           apart_px(half_readout_s * (velocity - input.velocity)) > kElsewhere_px;
    const bool blurred = exposure_s > 0.0 &&
                         apart_px(exposure_motion - input.exposure_motion) > kBlurred_px &&
                         apart_px(exposure_s * found->change) < kEvenly * apart_px(exposure_motion);
    if (!elsewhere && !blurred) return;
    const Vector6d velocity_before = input.velocity;
    if (!result.velocity) input.velocity = velocity;
    const Vector6d exposure_motion_before = input.exposure_motion;
    if (blurred) input.exposure_motion = exposure_motion;
    // The residual must not increase, unless rows are displaced after a tracked pose.
    const double residual = elsewhere && history.was_tracked()
                                ? std::numeric_limits<double>::infinity()
                                : result.residual_rms;
    alignment.run();
    if (result.verified && result.residual_rms <= residual) continue;
    input.velocity = velocity_before;
    input.exposure_motion = exposure_motion_before;
    alignment.run();
    return;
  }
}

bool align_with_motion_blur(const PoseHistory& history, const CameraModel& camera,
                            const Frame& frame, Alignment& alignment, MotionBlurError& blur) {
  AlignmentInput& input = alignment.input;
  const AlignmentResult& result = alignment.result;
  // Blur and tilt of a single tag look alike.
  if (result.tags_verified < 2 || blur.motion.isZero(0.0) || !input.exposure_motion.isZero(0.0))
    return false;
  const double residual = result.residual_rms;
  const int tags_before = result.tags_verified;
  input.exposure_motion = blur.motion;
  alignment.run();
  const bool enough = result.tags_verified >= 2 && 4 * result.tags_verified >= 3 * tags_before;
  // Compares fractions of the gain, because a correctly blurred model also restores the gain.
  if (result.verified && enough && result.residual_rms <= residual && result.inconsistent_tag < 0 &&
      !many_are_inconsistent(result)) {
    const MotionBlurError remaining =
        estimate_motion(history, camera, frame, alignment, kAlignedBlur_cells).blur;
    // A pose with a motion below a cell may have drifted along a blur that is still present.
    const auto blur_is_present = [&] {
      const auto any = alignment.aligner.motion_blur_error(std::nullopt, false, kAlignedBlur_cells);
      return any.shift_px > 0.0;
    };
    const bool drifted = remaining.shift_px == 0.0 && blur_is_present();
    if (remaining.shift_px < blur.shift_px && !drifted) {
      blur = remaining;
      return true;
    }
  }
  input.exposure_motion.setZero();
  alignment.run();
  return false;
}

}  // namespace penumbra
