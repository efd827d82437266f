#include "tracking/pose_confidence.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/evaluation/evaluation.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

// Systematic errors that the covariance does not include; see docs/tracking.md#bias.
constexpr double kTagBias_px = 0.01;    // common to all edges of a tag
constexpr double kSpreadBias_px = 0.1;  // bias of an edge whose point spread overlaps the next edge
constexpr double kPartsOfTag = 8.0;     // number of edge groups with independent kSpreadBias_px
constexpr double kToneBias_px = 0.04;   // common to all edges if the camera response is unknown
// Error of the mean pose during an exposure, divided by ImageMotion::unpredicted_px, if the
// exposure lasts until the next frame.
constexpr double kExposureShare = 1.0 / 24.0;
// RMS of the square of a number that is uniformly distributed from 0 to 1: 1 / sqrt(5).
constexpr double kUniformSquare = 0.4472135954999579;
// Sigma of a uniform blur of unit length: 1 / sqrt(12).
constexpr double kBlurShare = 0.288675134594813;

// Corrections to a covariance that assumes independent residuals and an exact model.
struct CovarianceInflation {
  double scatter = 1.0;  // factor for correlated residuals and tags that disagree
  double bias = 0.0;     // added factor for tag displacements that are the same in every frame
};

// Adds kTagBias_px only for several tags, because it displaces a tag relative to the others.
CovarianceInflation inflation_of(const AlignmentResult& result, double blur_px, double noise_px) {
  CovarianceInflation inflation;
  // Takes the maximum, because the disagreement includes some of the correlation.
  inflation.scatter = variance_inflation(result);
  if (result.map_covariance.isZero(0.0))
    inflation.scatter = std::max(inflation.scatter, result.disagreement);
  if (result.tags_verified == 0 || !(noise_px > 0.0)) return inflation;
  double bias2 = result.tags_verified > 1 ? kTagBias_px * kTagBias_px : 0.0;
  const double spread_px = std::min(kSpreadBias_px, noise_px);
  for (const TagAlignment& tag : result.tags) {
    if (!tag.verified) continue;
    const double overlap = std::exp(-std::pow(tag.cell_px / blur_px, 2) / 8.0);
    bias2 += std::pow(spread_px * overlap, 2) / (kPartsOfTag * result.tags_verified);
  }
  inflation.bias = bias2 / (noise_px * noise_px) * result.counters.samples / result.tags_verified;
  return inflation;
}

// The pose selected from the two poses of a measurement.
struct Choice {
  RefinedPose pose;
  bool open = false;        // the other pose remains possible and differs visibly
  double between_px = 0.0;  // overlay distance to the other pose [px]; 0: that pose is excluded
};

Choice choose(const RigidTags& group, const Measurement& measurement,
              const std::optional<MapFromCamera>& predicted) {
  constexpr double kClearly = 3.0;  // ratio of the distances to the prediction for a decision
  Choice choice{measurement.best};
  if (!measurement.second || !measurement.ambiguous) return choice;
  const RefinedPose& second = *measurement.second;
  const auto apart_px = [&](const MapFromCamera& a, const MapFromCamera& b) {
    return overlay_difference(group.camera, a, b).rms_px();
  };
  choice.between_px = apart_px(measurement.best.T_map_camera, second.T_map_camera);
  choice.open = choice.between_px > kTrackedOverlay_px;
  if (!choice.open || !predicted) return choice;
  const double best_px = apart_px(measurement.best.T_map_camera, *predicted);
  const double second_px = apart_px(second.T_map_camera, *predicted);
  if (best_px * kClearly < second_px) {
    choice.open = false;
  } else if (second_px * kClearly < best_px) {
    choice.open = false;
    choice.pose = second;
  }
  if (!choice.open) choice.between_px = 0.0;
  return choice;
}

// Returns why a predicted error is too large. `pose_px`, `map_px`: error without lens, of the map.
PoseReason reason_of_error(const CameraModel& camera, const MapPoseEstimate& estimate,
                           double pose_px, double map_px) {
  const double predicted_px = estimate.predicted_overlay_error_px;
  if (!std::isfinite(predicted_px)) return {PoseCause::out_of_sight};
  if (pose_px < kTrackedOverlay_px)
    return {PoseCause::uncertain_lens, camera.parameters().overlay_sigma_px.value_or(0.0)};
  const bool by_map = pose_px * pose_px - map_px * map_px < kTrackedOverlay_px * kTrackedOverlay_px;
  return {by_map ? PoseCause::uncertain_map : PoseCause::large_error, predicted_px};
}

}  // namespace

std::optional<RefinedPose> pose_of(const RigidTags& group, const Alignment& alignment,
                                   const ImageMotion& motion) {
  const AlignmentResult& result = alignment.result;
  const double lens_blur_px = alignment.aligner.options().blur_px;
  if (!result.verified || !result.T_map_camera.is_finite() || !result.covariance.allFinite())
    return std::nullopt;
  RefinedPose pose;
  pose.T_map_camera = result.T_map_camera;
  // Converts residuals to displacements: the slope of a blurred edge is gain / (sqrt(2 pi) sigma).
  pose.noise_px = result.residual_rms * std::sqrt(2.0 * std::numbers::pi) * lens_blur_px;
  pose.rms_px = std::sqrt(2.0) * pose.noise_px;
  const CovarianceInflation inflation = inflation_of(result, lens_blur_px, pose.noise_px);
  const Matrix6d& posterior = result.covariance;
  const Matrix6d prior_information = inverse_of_spd(alignment.input.covariance);
  const Matrix6d prior_share = result.velocity ? result.velocity->prior_share
                                               : (posterior * prior_information * posterior).eval();
  pose.covariance = inflation.scatter * posterior - (inflation.scatter - 1.0) * prior_share;
  if (inflation.bias > 0.0) {
    // Limits the bias to 1 m and 1 rad where the image gives no information.
    const Matrix6d image_information = result.velocity
                                           ? result.velocity->image_information
                                           : inverse_of_spd(posterior) - prior_information;
    pose.covariance += inflation.bias * inverse_of_spd(image_information + Matrix6d::Identity());
  }
  pose.covariance += result.map_covariance + motion.blur.covariance;
  pose.covariance = 0.5 * (pose.covariance + pose.covariance.transpose()).eval();
  const double predicted_px =
      predicted_overlay_error_px(group.camera, result.T_map_camera, pose.covariance);
  if (predicted_px > 0.0 && std::isfinite(predicted_px)) {
    const double excess_px = motion.sharp.excess_px(pose.rms_px);
    const double blur_px = std::min(kBlurShare * motion.longest_blur_px(), excess_px);
    const bool is_sharp = excess_px == 0.0;
    const double exposure_px = (is_sharp && !motion.exposure.known ? kUniformSquare : 1.0) *
                               std::pow(motion.exposure.of_interval, 2) * kExposureShare *
                               motion.unpredicted_px;
    const double systematic_px =
        std::hypot(group.camera.parameters().tone_curve ? 0.0 : kToneBias_px, exposure_px,
                   std::hypot(blur_px, motion.blur.shift_px));
    pose.covariance *= 1.0 + systematic_px * systematic_px / (predicted_px * predicted_px);
  }
  return pose;
}

void set_aligned_pose(const RigidTags& group, const Alignment& alignment, const RefinedPose& pose,
                      Measurement& measurement) {
  const AlignmentResult& result = alignment.result;
  measurement.best = pose;
  measurement.aligned = true;
  measurement.variance_inflation = variance_inflation(result);
  measurement.tags_used = result.tags_verified;
  if (result.map_inconsistent)
    measurement.map_px =
        predicted_overlay_error_px(group.camera, pose.T_map_camera, result.map_covariance);
}

double samples_needed(const CameraModel& camera, const AlignmentResult& result, double budget_px) {
  const double noise_px =
      std::sqrt(variance_inflation(result)) *
      predicted_overlay_error_px(camera, result.T_map_camera, result.covariance);
  const double tone_px = camera.parameters().tone_curve ? 0.0 : kToneBias_px;
  const double budget2 = budget_px * budget_px - tone_px * tone_px;
  if (!(budget2 > 0.0) || !std::isfinite(noise_px)) return std::numeric_limits<double>::infinity();
  return noise_px * noise_px / budget2;
}

AssessedPose judge(const RigidTags& group, const Measurement& measurement,
                   const std::optional<MapFromCamera>& predicted) {
  const Choice chosen = choose(group, measurement, predicted);
  const MapFromCamera& pose = chosen.pose.T_map_camera;
  AssessedPose judged;
  MapPoseEstimate& estimate = judged.estimate;
  estimate.T_map_camera = pose;
  // Tags in view but not read indicate blur or a grazing view (docs/tracking.md#unread-tags).
  const double ratio = measurement.aligned
                           ? 1.0
                           : static_cast<double>(std::max(group.in_view(pose), 1)) /
                                 static_cast<double>(std::max(measurement.tags_used, 1));
  estimate.covariance = chosen.pose.covariance * std::max(ratio, 1.0);
  estimate.reprojection_rms_px = chosen.pose.rms_px;
  estimate.ambiguity_ratio = measurement.ambiguity_ratio;
  estimate.tags_used = measurement.tags_used;
  for (const int index : measurement.rejected)
    estimate.tags_rejected.push_back({group[index].id, TagRejection::inconsistent});
  const double of_pose_px = std::hypot(
      predicted_overlay_error_px(group.camera, pose, estimate.covariance), chosen.between_px);
  estimate.predicted_overlay_error_px = add_lens_uncertainty_px(group.camera, of_pose_px);
  estimate.status = TrackStatus::uncertain;
  if (measurement.inconsistent) {
    estimate.reason = {PoseCause::inconsistent_tags};
  } else if (chosen.open) {
    estimate.reason = {PoseCause::two_poses};
  } else if (!(estimate.predicted_overlay_error_px < kTrackedOverlay_px)) {
    estimate.reason = reason_of_error(group.camera, estimate, of_pose_px, measurement.map_px);
    judged.only_lens_uncertain =
        std::isfinite(estimate.predicted_overlay_error_px) && of_pose_px < kTrackedOverlay_px;
  } else {
    estimate.status = TrackStatus::tracked;
  }
  return judged;
}

}  // namespace penumbra
