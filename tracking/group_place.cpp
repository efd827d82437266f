#include "tracking/group_place.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "core/evaluation/evaluation.hpp"
#include "core/units.hpp"
#include "tracking/math/se3.hpp"
#include "tracking/motion/motion_model.hpp"
#include "tracking/pose_confidence.hpp"

namespace penumbra {
namespace {

// 99 % quantile of chi-square (6 degrees of freedom) for measurements that agree.
constexpr double kAgreementQuantile = 16.8;
// Growth of a resting group's covariance per frame; the average contains about five frames.
constexpr double kCovarianceGrowth = 1.25;
// Maximum distance of the displayed pose from the average, and of the average from a measurement.
constexpr double kShownWithin_px = 0.25;
// Maximum time between two measurements that define a velocity.
constexpr double kVelocityLifetime_s = 0.2;

// Returns the adjoint Ad of the transform: T_a_b exp(xi_b) = exp(Ad xi_b) T_a_b.
template <class A, class B>
Matrix6d adjoint(const Transform<A, B>& T_a_b) {
  const Eigen::Matrix3d R = T_a_b.rotation_matrix();
  Matrix6d A6 = Matrix6d::Zero();
  A6.topLeftCorner<3, 3>() = R;
  A6.topRightCorner<3, 3>() = skew(T_a_b.translation()) * R;
  A6.bottomRightCorner<3, 3>() = R;
  return A6;
}

// Propagates the covariance of a group's place to the camera's pose over the group's middle.
Matrix6d propagated_to_camera(const MiddleFromCamera& T_middle_camera, const Matrix6d& covariance) {
  const MiddleFromCamera normalised(T_middle_camera.rotation(), T_middle_camera.translation());
  const Matrix6d A = adjoint(normalised.inverse());
  return A * covariance * A.transpose();
}

double overlay_distance_px(const CameraModel& camera, const MiddleFromCamera& a,
                           const MiddleFromCamera& b) {
  return overlay_difference(camera, as_map_pose(a), as_map_pose(b)).rms_px();
}

double predicted_overlay_px(const CameraModel& camera, const MiddleFromCamera& pose,
                            const Matrix6d& covariance) {
  return add_lens_uncertainty_px(camera,
                                 predicted_overlay_error_px(camera, as_map_pose(pose), covariance));
}

TrackStatus worse(TrackStatus a, TrackStatus b) {
  return std::max(a, b);  // declared from best to worst
}
static_assert(TrackStatus::tracked < TrackStatus::uncertain &&
              TrackStatus::uncertain < TrackStatus::held && TrackStatus::held < TrackStatus::lost);

}  // namespace

bool GroupPlace::add_measurement(const CameraModel& camera, const Place& now, bool uncertain,
                                 const CameraPose& T_table_camera) {
  const auto apart_px = [&](const TableFromMiddle& a, const TableFromMiddle& b) {
    return overlay_distance_px(camera, a.inverse() * T_table_camera, b.inverse() * T_table_camera);
  };
  bool agrees = false;
  if (found_) {
    Place& found = *found_;
    const Vector6d away = perturbation_between(found.T_table_middle, now.T_table_middle);
    const Matrix6d before = kCovarianceGrowth * found.covariance;
    const Matrix6d total = before + now.covariance;
    const Vector6d weighed = total.ldlt().solve(away);
    agrees = away.dot(weighed) < kAgreementQuantile &&
             apart_px(found.T_table_middle, now.T_table_middle) <= kShownWithin_px;
    if (!agrees && uncertain) return false;
    if (agrees) {
      const Matrix6d gain = total.ldlt().solve(before).transpose();  // before * total^-1
      found.T_table_middle = perturbed(found.T_table_middle, before * weighed);
      found.covariance = before - gain * before;
      found.covariance = 0.5 * (found.covariance + found.covariance.transpose()).eval();
      found.timestamp_ns = now.timestamp_ns;
      velocity_.setZero();
    } else {
      const double step_s = seconds(now.timestamp_ns - found.timestamp_ns);
      velocity_ = step_s > 0.0 && step_s <= kVelocityLifetime_s ? Vector6d(away / step_s)
                                                                : Vector6d::Zero();
    }
  }
  if (!agrees) found_ = now;
  const bool same_view = agrees && apart_px(shown_, found_->T_table_middle) <= kShownWithin_px;
  if (!same_view) shown_ = found_->T_table_middle;
  rests_ = agrees;
  return true;
}

GroupEstimate GroupPlace::coasting(const CameraModel& camera, double hold_s,
                                   std::int64_t timestamp_ns, const PoseEstimate& table_pose,
                                   PoseReason reason) const {
  GroupEstimate estimate;
  estimate.name = name_;
  estimate.T_group_middle = T_group_middle_;
  estimate.reason = std::move(reason);
  if (!found_ || !table_pose.has_pose()) return estimate;
  const double age_s = seconds(timestamp_ns - found_->timestamp_ns);
  if (!(age_s >= 0.0) || age_s > hold_s) return estimate;
  const TableFromMiddle at = perturbed(shown_, velocity_ * age_s);
  if (!at.is_finite()) return estimate;
  estimate.status = TrackStatus::held;
  estimate.held_from = last_status_;
  estimate.age_s = age_s;
  estimate.rests = rests_;
  estimate.T_table_group = at * T_group_middle_.inverse();
  const MiddleFromCamera T_middle_camera = at.inverse() * table_pose.T_table_camera;
  const Matrix6d of_group = found_->covariance + extrapolation_covariance(age_s);
  estimate.covariance = table_pose.covariance + propagated_to_camera(T_middle_camera, of_group);
  estimate.predicted_overlay_error_px =
      predicted_overlay_px(camera, T_middle_camera, estimate.covariance);
  return estimate;
}

GroupEstimate GroupPlace::update(const CameraModel& camera, double hold_s,
                                 std::int64_t timestamp_ns, const PoseEstimate& table_pose,
                                 const MapPoseEstimate& seen) {
  const auto coast = [&](PoseReason reason) {
    return coasting(camera, hold_s, timestamp_ns, table_pose, std::move(reason));
  };
  // Discards the history if the clock jumped back.
  if (found_ && timestamp_ns <= found_->timestamp_ns) found_.reset();
  if (!is_measured(seen.status))
    return coast(seen.reason.cause == PoseCause::none ? PoseReason{PoseCause::group_not_seen}
                                                      : seen.reason);
  if (!is_measured(table_pose.status)) {
    return coast(
        {table_pose.status == TrackStatus::held ? PoseCause::table_held : PoseCause::table_lost});
  }
  Place now;
  now.timestamp_ns = timestamp_ns;
  const MiddleFromCamera T_middle_camera = over_middle(seen);
  now.T_table_middle = table_pose.T_table_camera * T_middle_camera.inverse();
  const Matrix6d A = adjoint(T_middle_camera);
  now.covariance = A * (table_pose.covariance + seen.covariance) * A.transpose();
  if (!now.T_table_middle.is_finite() || !now.covariance.allFinite())
    return coast({PoseCause::no_finite_place});
  const bool uncertain = worse(seen.status, table_pose.status) != TrackStatus::tracked;
  const bool old = found_ && seconds(timestamp_ns - found_->timestamp_ns) > hold_s;
  if (!add_measurement(camera, now, uncertain && !old, table_pose.T_table_camera))
    return coast(seen.reason.cause == PoseCause::none ? table_pose.reason : seen.reason);
  return measured(camera, table_pose, seen);
}

GroupEstimate GroupPlace::measured(const CameraModel& camera, const PoseEstimate& table_pose,
                                   const MapPoseEstimate& seen) {
  GroupEstimate estimate;
  estimate.name = name_;
  estimate.T_group_middle = T_group_middle_;
  estimate.T_table_group = shown_ * T_group_middle_.inverse();
  static_cast<MeasuredTags&>(estimate) = seen;
  estimate.rests = rests_;
  const MiddleFromCamera pose = shown_.inverse() * table_pose.T_table_camera;
  if (rests_) {
    // The group is drawn with the table's pose, at a place averaged over several frames.
    estimate.covariance = table_pose.covariance + propagated_to_camera(pose, found_->covariance);
  } else {
    estimate.covariance = seen.covariance;
  }
  estimate.predicted_overlay_error_px = predicted_overlay_px(camera, pose, estimate.covariance);
  if (rests_) {
    // Assumes that the two distances of kShownWithin_px are uniformly distributed up to this limit.
    estimate.predicted_overlay_error_px =
        std::hypot(estimate.predicted_overlay_error_px, kShownWithin_px * std::sqrt(2.0 / 3.0));
  }
  estimate.status = worse(seen.status, table_pose.status);
  if (estimate.status == TrackStatus::tracked &&
      !(estimate.predicted_overlay_error_px < kTrackedOverlay_px)) {
    estimate.status = TrackStatus::uncertain;
    estimate.reason = {PoseCause::large_error, estimate.predicted_overlay_error_px};
  } else if (estimate.status == TrackStatus::uncertain) {
    estimate.reason =
        seen.status == TrackStatus::uncertain ? seen.reason : reason_by_table(table_pose.reason);
  }
  last_status_ = estimate.status;
  return estimate;
}

}  // namespace penumbra
