#include "tracking/motion/pose_history.hpp"

#include <algorithm>
#include <limits>
#include <utility>

#include "core/evaluation/evaluation.hpp"
#include "core/units.hpp"
#include "tracking/motion/motion_model.hpp"

namespace penumbra {

void PoseHistory::begin_frame(std::int64_t timestamp_ns) {
  if (last_ && timestamp_ns <= last_->timestamp_ns) {
    last_.reset();
    before_last_.reset();
  }
  if (located_ && timestamp_ns <= located_->timestamp_ns) {
    located_.reset();
    before_located_.reset();
  }
  frame_interval_s_ = 0.0;
  if (previous_frame_ns_)
    frame_interval_s_ = std::max(seconds(timestamp_ns - *previous_frame_ns_), 0.0);
  previous_frame_ns_ = timestamp_ns;
}

void PoseHistory::add(std::int64_t timestamp_ns, const MapPoseEstimate& estimate, bool is_located,
                      bool continues) {
  last_status_ = estimate.status;
  const TimedPose added{timestamp_ns, estimate.T_map_camera, estimate.covariance,
                        estimate.status == TrackStatus::tracked};
  if (is_located) before_located_ = std::exchange(located_, added);
  if (continues) before_last_ = std::exchange(last_, added);
}

std::optional<MapFromCamera> PoseHistory::predict(std::int64_t timestamp_ns) const {
  if (!last_) return std::nullopt;
  if (!before_last_) return last_->pose;
  const double step_s = seconds(last_->timestamp_ns - before_last_->timestamp_ns);
  if (!(step_s > 0.0) || step_s > kPriorLifetime_s) return last_->pose;
  const double ahead_s = seconds(timestamp_ns - last_->timestamp_ns);
  const Vector6d xi = perturbation_between(before_last_->pose, last_->pose);
  return perturbed(last_->pose, xi * (ahead_s / step_s));
}

std::optional<MapFromCamera> PoseHistory::recent_prediction(std::int64_t timestamp_ns) const {
  const bool recent = last_ && seconds(timestamp_ns - last_->timestamp_ns) <= kPriorLifetime_s;
  return recent ? predict(timestamp_ns) : std::nullopt;
}

std::optional<CameraMotion> PoseHistory::motion_at(std::int64_t timestamp_ns,
                                                   const MapFromCamera& pose) const {
  if (!located_) return std::nullopt;
  const double step_s = seconds(timestamp_ns - located_->timestamp_ns);
  if (!(step_s > 0.0 && step_s <= kPriorLifetime_s)) return std::nullopt;
  const Vector6d mean = perturbation_between(located_->pose, pose) / step_s;
  CameraMotion motion{mean, mean, true};
  if (before_located_) {
    const double before_s = seconds(located_->timestamp_ns - before_located_->timestamp_ns);
    if (before_s > 0.0 && before_s <= kPriorLifetime_s) {
      motion.change = mean - perturbation_between(before_located_->pose, located_->pose) / before_s;
      motion.velocity += step_s / (step_s + before_s) * motion.change;
      motion.of_one_step = false;
    }
  }
  if (!motion.velocity.allFinite() || !motion.change.allFinite()) return std::nullopt;
  return motion;
}

MapPoseEstimate PoseHistory::coast(const CameraModel& camera, std::int64_t timestamp_ns,
                                   double hold_s, PoseReason reason) const {
  MapPoseEstimate estimate;
  estimate.reason = std::move(reason);
  if (!last_) return estimate;
  const double age_s = seconds(timestamp_ns - last_->timestamp_ns);
  if (!(age_s >= 0.0) || age_s > hold_s) return estimate;
  const std::optional<MapFromCamera> predicted = predict(timestamp_ns);
  if (!predicted || !predicted->is_finite()) return estimate;
  estimate.status = TrackStatus::held;
  estimate.held_from = last_status_;
  estimate.T_map_camera = *predicted;
  estimate.age_s = age_s;
  estimate.ambiguity_ratio = std::numeric_limits<double>::infinity();
  estimate.covariance = last_->covariance + extrapolation_covariance(age_s);
  estimate.predicted_overlay_error_px = add_lens_uncertainty_px(
      camera, predicted_overlay_error_px(camera, estimate.T_map_camera, estimate.covariance));
  return estimate;
}

}  // namespace penumbra
