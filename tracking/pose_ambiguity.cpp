#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "core/evaluation/evaluation.hpp"
#include "tracking/pose_confidence.hpp"

namespace penumbra {
namespace {

// Tuned on random images of a single tag; see docs/tracking.md#two-poses.
constexpr double kMinLogLikelihoodRatio = 9.0;  // minimum log-likelihood ratio for a decision
// Two poses whose tag corners differ by less than this are treated as one [px].
constexpr double kSame_px = 0.15;
// If all cells are below kOverlap_sigmas, poses are treated as one if their tag corners differ by
// less than kSameResiduals times the residuals.
constexpr double kSameResiduals = 2.0;
constexpr double kOverlap_sigmas = 5.0;   // cell size at which edges blur into each other
constexpr double kResolvedCell_px = 1.0;  // two poses are ambiguous if all cells are smaller

// Returns the pose from which the coplanar verified tags look the same except for perspective.
MapFromCamera mirrored(const RigidTags& group, const MapFromCamera& pose,
                       std::span<const TagAlignment> seen) {
  const Transform<frame::Camera, frame::Map> T_camera_map = pose.inverse();
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();  // mean centre of the verified tags, map frame
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  int count = 0;
  for (const TagAlignment& tag : seen) {
    if (!tag.verified) continue;
    const auto& T_table_tag = group[tag.index].T_table_tag;
    if (count++ == 0) normal = T_table_tag.rotation() * Eigen::Vector3d::UnitZ();
    middle += T_table_tag.translation();
  }
  if (count > 0) middle /= count;
  const Eigen::Vector3d at = T_camera_map * middle;
  const Eigen::Vector3d sight = at.normalized();
  const auto reflection = [](const Eigen::Vector3d& n) {
    return Eigen::Matrix3d(Eigen::Matrix3d::Identity() - 2.0 * n * n.transpose());
  };
  const Eigen::Matrix3d R = reflection(sight) * T_camera_map.rotation_matrix() * reflection(normal);
  return Transform<frame::Camera, frame::Map>(Eigen::Quaterniond(R), at - R * middle).inverse();
}

}  // namespace

bool add_second_pose(const RigidTags& group, const Alignment& first, const ImageMotion& motion,
                     Measurement& measurement) {
  const std::vector<TagAlignment>& seen = first.result.tags;
  Alignment other{first.aligner, {}, false};
  other.input.luma = first.input.luma;
  other.input.exposure_motion = first.input.exposure_motion;
  other.input.velocity = first.input.velocity;
  other.input.velocity_prior = first.input.velocity_prior;
  if (other.input.velocity_prior) other.input.velocity_prior->cross_covariance.setZero();
  other.input.predicted = mirrored(group, measurement.best.T_map_camera, seen);
  other.input.covariance = uninformative_covariance();
  other.input.rejected = first.input.rejected;
  measurement.second.reset();
  measurement.ambiguous = false;
  measurement.ambiguity_ratio = std::numeric_limits<double>::infinity();
  if (!other.input.predicted.is_finite()) return false;
  double largest_cell_px = 0.0;
  for (const TagAlignment& tag : seen) {
    if (tag.verified) largest_cell_px = std::max(largest_cell_px, tag.cell_px);
  }
  const bool unresolved = largest_cell_px < kResolvedCell_px;
  const bool overlap = largest_cell_px <= kOverlap_sigmas * first.aligner.options().blur_px;
  const double residuals = overlap ? kSameResiduals : 0.0;
  const auto look_the_same = [&](const MapFromCamera& pose, double residual_px) {
    return group.corner_distance_px(measurement.best.T_map_camera, pose, seen) <
           std::max(kSame_px, residuals * residual_px);
  };
  const MapFromCamera mirror = other.input.predicted;
  other.run();
  const std::optional<RefinedPose> second = pose_of(group, other, motion);
  if (!second) {
    // Only the first pose reads the cells, so it is the true pose unless the cells are unresolved
    // or the two look the same.
    if (unresolved || look_the_same(mirror, measurement.best.noise_px)) {
      measurement.second = measurement.best;
      measurement.second->T_map_camera = mirror;
      measurement.ambiguous = true;
      measurement.ambiguity_ratio = 1.0;
    }
    return false;
  }
  // The second pose equals the best within its covariance.
  constexpr double kSamePose_sigmas = 2.0;
  if (overlay_difference(group.camera, measurement.best.T_map_camera, second->T_map_camera)
          .rms_px() < kSamePose_sigmas * predicted_overlay_error_px(group.camera,
                                                                    measurement.best.T_map_camera,
                                                                    measurement.best.covariance))
    return false;
  const double samples = static_cast<double>(other.result.counters.samples);
  double inflation = std::max(measurement.variance_inflation, variance_inflation(other.result));
  double first_residual = measurement.best.noise_px;
  if (second->noise_px < first_residual) {
    // The first pose was also fitted to a prediction. Aligns it again without one.
    other.input.predicted = measurement.best.T_map_camera;
    other.run();
    const std::optional<RefinedPose> again = pose_of(group, other, motion);
    if (again) {
      first_residual = std::min(first_residual, again->noise_px);
      inflation = std::max(inflation, variance_inflation(other.result));
    }
  }
  measurement.second = second;
  const double ratio = second->noise_px / std::max(first_residual, 1e-9);
  const bool second_fits = ratio < 1.0;
  measurement.ambiguity_ratio = second_fits ? 1.0 / std::max(ratio, 1e-9) : ratio;
  measurement.ambiguous =
      unresolved ||
      look_the_same(second->T_map_camera, std::min(first_residual, second->noise_px)) ||
      samples * std::log(measurement.ambiguity_ratio) < kMinLogLikelihoodRatio * inflation;
  if (second_fits) std::swap(measurement.best, *measurement.second);
  return second_fits;
}

}  // namespace penumbra
