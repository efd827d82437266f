#include "core/evaluation/evaluation.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <tuple>

#include "core/units.hpp"

namespace penumbra {
namespace {

// Interpolates linearly between the order statistics of sorted values.
double quantile(const std::vector<double>& sorted, double share) {
  const double position = share * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<std::size_t>(position);
  const std::size_t above = std::min(below + 1, sorted.size() - 1);
  const double weight = position - static_cast<double>(below);
  return sorted[below] + weight * (sorted[above] - sorted[below]);
}

// Returns d pixel / d p_camera of CameraModel::project_extended(); by central differences beyond
// max_radius.
inline std::optional<Eigen::Matrix<double, 2, 3>> projection_jacobian(const CameraModel& camera,
                                                                      const Eigen::Vector3d& p) {
  Eigen::Matrix<double, 2, 3> J;
  if (camera.project(p)) {
    std::ignore = camera.project_unchecked(p, &J);
  } else {
    const double step = 1e-6 * p.z();
    for (int axis = 0; axis < 3; ++axis) {
      Eigen::Vector3d offset = Eigen::Vector3d::Zero();
      offset[axis] = step;
      const std::optional<Eigen::Vector2d> high = camera.project_extended(p + offset);
      const std::optional<Eigen::Vector2d> low = camera.project_extended(p - offset);
      if (!high || !low) return std::nullopt;
      J.col(axis) = (*high - *low) / (2.0 * step);
    }
  }
  if (!J.allFinite()) return std::nullopt;
  return J;
}

// Error of a corner that the estimate puts behind the camera: the angle between the two directions
// times the focal length. Omitting it would favour the worst poses.
inline double error_behind_camera_px(const CameraModel& camera, const Eigen::Vector3d& p_estimated,
                                     const Eigen::Vector3d& p_true) {
  const double angle =
      std::atan2(p_estimated.stableNormalized().cross(p_true.stableNormalized()).norm(),
                 p_estimated.stableNormalized().dot(p_true.stableNormalized()));
  return std::max(camera.parameters().fx, camera.parameters().fy) * angle;
}

class ErrorCollector {
 public:
  explicit ErrorCollector(const CameraModel& camera) : camera_(camera) {}

  // `consecutive`: the previous frame was also added, so that the jitter can use both.
  PoseErrors add(const StampedPose& pose, const CameraPose& truth, bool consecutive) {
    const CameraPose& estimated = pose.T_table_camera;
    PoseErrors errors;
    errors.timestamp_ns = pose.timestamp_ns;
    errors.predicted_px = pose.predicted_px;
    errors.translation_mm = 1e3 * (estimated.translation() - truth.translation()).norm();
    errors.rotation_deg = degrees(estimated.rotation().angularDistance(truth.rotation()));
    translation_mm_.push_back(errors.translation_mm);
    rotation_deg_.push_back(errors.rotation_deg);
    const OverlayDifference difference = overlay_difference(camera_, estimated, truth);
    bool any = false;
    double pose_change = 0.0;
    int changes = 0;
    for (std::size_t i = 0; i < difference.valid.size(); ++i) {
      if (!difference.valid[i]) continue;
      any = true;
      corner_errors_px_.push_back(difference.difference_px[i].norm());
      if (consecutive && previous_.valid[i]) {
        const double change =
            (difference.difference_px[i] - previous_.difference_px[i]).squaredNorm();
        change_sum_ += change;
        pose_change += change;
        ++changes;
      }
    }
    change_count_ += changes;
    if (any) errors.overlay_px = frame_rms_px_.emplace_back(difference.rms_px());
    if (any && pose.predicted_px > 0.0)
      errors.ratio = ratio_.emplace_back(*errors.overlay_px / *pose.predicted_px);
    if (changes > 0) errors.jitter_px = std::sqrt(pose_change / changes);
    previous_ = difference;
    return errors;
  }

  void finish(Evaluation& result) {
    result.translation_mm = statistics_of(std::move(translation_mm_));
    result.rotation_deg = statistics_of(std::move(rotation_deg_));
    result.overlay_px = statistics_of(std::move(corner_errors_px_));
    result.overlay_frame_px = statistics_of(std::move(frame_rms_px_));
    result.frames_with_ratio = static_cast<int>(ratio_.size());
    if (!ratio_.empty()) {
      result.share_above_3 =
          static_cast<double>(std::ranges::count_if(ratio_, [](double r) { return r > 3.0; })) /
          static_cast<double>(ratio_.size());
    }
    result.frame_ratio = statistics_of(std::move(ratio_));
    result.jitter_changes = change_count_;
    result.jitter_px = change_count_ == 0 ? 0.0 : std::sqrt(change_sum_ / change_count_);
  }

 private:
  const CameraModel& camera_;
  std::vector<double> translation_mm_, rotation_deg_, corner_errors_px_, frame_rms_px_, ratio_;
  OverlayDifference previous_;
  double change_sum_ = 0.0;
  int change_count_ = 0;
};

// Returns the index of the pose nearest in time; the trajectory must not be empty.
std::size_t nearest_index(const Trajectory& trajectory, std::int64_t time_ns) {
  const auto& poses = trajectory.poses;
  const auto after = std::ranges::lower_bound(poses, time_ns, {}, &StampedPose::timestamp_ns);
  if (after == poses.begin()) return 0;
  const auto index = static_cast<std::size_t>(after - poses.begin());
  if (after == poses.end()) return index - 1;
  // double, because the difference of two times may exceed 64 bits.
  const double to_before =
      static_cast<double>(time_ns) - static_cast<double>(poses[index - 1].timestamp_ns);
  const double to_after = static_cast<double>(after->timestamp_ns) - static_cast<double>(time_ns);
  return to_before < to_after ? index - 1 : index;
}

}  // namespace

std::array<Eigen::Vector3d, 8> overlay_cube() {
  std::array<Eigen::Vector3d, 8> corners;
  for (unsigned i = 0; i < 8; ++i) {
    corners[i] = {(i & 1U) != 0 ? 0.1 : -0.1, (i & 2U) != 0 ? 0.1 : -0.1,
                  (i & 4U) != 0 ? 0.2 : 0.0};
  }
  return corners;
}

Statistics statistics_of(std::vector<double> values) {
  Statistics result;
  if (values.empty()) return result;
  std::sort(values.begin(), values.end());
  double sum = 0.0;
  for (const double value : values) sum += value * value;
  result.rmse = std::sqrt(sum / static_cast<double>(values.size()));
  result.median = quantile(values, 0.5);
  result.p95 = quantile(values, 0.95);
  result.max = values.back();
  return result;
}

double OverlayDifference::rms_px() const {
  double sum = 0.0;
  int count = 0;
  for (std::size_t i = 0; i < difference_px.size(); ++i) {
    if (!valid[i]) continue;
    sum += difference_px[i].squaredNorm();
    ++count;
  }
  return count == 0 ? std::numeric_limits<double>::infinity() : std::sqrt(sum / count);
}

template <class Origin>
OverlayDifference overlay_difference(const CameraModel& camera,
                                     const Transform<Origin, frame::Camera>& estimated,
                                     const Transform<Origin, frame::Camera>& truth) {
  OverlayDifference result;
  const auto T_estimated_origin = estimated.inverse();
  const auto T_true_origin = truth.inverse();
  const std::array<Eigen::Vector3d, 8> corners = overlay_cube();
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector3d p_estimated = T_estimated_origin * corners[i];
    const Eigen::Vector3d p_true = T_true_origin * corners[i];
    const std::optional<Eigen::Vector2d> a = camera.project_extended(p_estimated);
    const std::optional<Eigen::Vector2d> b = camera.project_extended(p_true);
    result.valid[i] = b.has_value();
    result.difference_px[i].setZero();
    if (a && b) {
      result.difference_px[i] = *a - *b;
    } else if (b) {
      result.difference_px[i].x() = error_behind_camera_px(camera, p_estimated, p_true);
    }
  }
  return result;
}
template OverlayDifference overlay_difference(const CameraModel&, const CameraPose&,
                                              const CameraPose&);
template OverlayDifference overlay_difference(const CameraModel&, const MapFromCamera&,
                                              const MapFromCamera&);

Evaluation evaluate(const CameraModel& camera, const Trajectory& estimated, const Trajectory& truth,
                    const PairingOptions& options, std::int64_t frame_interval_ns) {
  Evaluation result;
  result.frames_with_truth = static_cast<int>(truth.poses.size());
  result.time_offset_ns = options.time_offset_ns;
  const std::int64_t interval_ns =
      frame_interval_ns > 0 ? frame_interval_ns : median_interval_ns(estimated);
  ErrorCollector errors(camera);
  std::int64_t previous_ns = 0;  // timestamp of the previous evaluated pose
  bool previous_evaluated = false;
  std::vector<bool> with_pose(truth.poses.size(), false);
  for (const StampedPose& pose : estimated.poses) {
    ++result.frames_estimated;
    const std::int64_t time_ns = shifted(pose.timestamp_ns, options.time_offset_ns);
    const auto true_pose = pose_at(truth, time_ns, options.max_gap_ns);
    if (!true_pose) {
      ++result.frames_not_judged[static_cast<std::size_t>(true_pose.error())];
      PoseErrors& unknown = result.poses.emplace_back();
      unknown.timestamp_ns = pose.timestamp_ns;
      unknown.not_judged = true_pose.error();
      unknown.predicted_px = pose.predicted_px;
      previous_evaluated = false;
      continue;
    }
    ++result.frames_judged;
    with_pose[nearest_index(truth, time_ns)] = true;
    const bool consecutive =
        previous_evaluated && pose.timestamp_ns - previous_ns <= interval_ns + interval_ns / 2;
    result.poses.push_back(errors.add(pose, *true_pose, consecutive));
    previous_ns = pose.timestamp_ns;
    previous_evaluated = true;
  }
  result.frames_with_pose = static_cast<int>(std::ranges::count(with_pose, true));
  errors.finish(result);
  return result;
}

Trajectory relative_to_group(const Trajectory& camera, const Trajectory& group,
                             const Transform<frame::Group, frame::GroupMiddle>& T_group_middle,
                             std::int64_t max_gap_ns) {
  Trajectory relative;
  for (const StampedPose& pose : camera.poses) {
    const auto group_pose = pose_at(group, pose.timestamp_ns, max_gap_ns);
    if (!group_pose) continue;
    const GroupPose T_table_group(group_pose->rotation(), group_pose->translation());
    const auto T_middle_camera = (T_table_group * T_group_middle).inverse() * pose.T_table_camera;
    relative.poses.push_back({pose.timestamp_ns,
                              CameraPose(T_middle_camera.rotation(), T_middle_camera.translation()),
                              {}});
  }
  return relative;
}

template <class Origin>
double predicted_overlay_error_px(const CameraModel& camera,
                                  const Transform<Origin, frame::Camera>& pose,
                                  const Eigen::Matrix<double, 6, 6>& covariance) {
  const auto T_camera_origin = pose.inverse();
  double sum = 0.0;
  int count = 0;
  for (const Eigen::Vector3d& corner : overlay_cube()) {
    const Eigen::Vector3d p = T_camera_origin * corner;
    if (!p.allFinite() || p.z() <= 0.0) continue;
    const std::optional<Eigen::Matrix<double, 2, 3>> J_p = projection_jacobian(camera, p);
    // Omitting a corner with an unknown error would favour the worst poses.
    if (!J_p) return std::numeric_limits<double>::infinity();
    // T exp([nu; omega]) moves the point to p - nu - omega x p = p - nu + [p]x omega.
    Eigen::Matrix<double, 3, 6> J_pose;
    J_pose << -1.0, 0.0, 0.0, 0.0, -p.z(), p.y(),  //
        0.0, -1.0, 0.0, p.z(), 0.0, -p.x(),        //
        0.0, 0.0, -1.0, -p.y(), p.x(), 0.0;
    const Eigen::Matrix<double, 2, 6> J = *J_p * J_pose;
    sum += (J * covariance * J.transpose()).trace();
    ++count;
  }
  if (count == 0 || !(sum >= 0.0)) return std::numeric_limits<double>::infinity();
  return std::sqrt(sum / count);
}
template double predicted_overlay_error_px(const CameraModel&, const CameraPose&,
                                           const Eigen::Matrix<double, 6, 6>&);
template double predicted_overlay_error_px(const CameraModel&, const MapFromCamera&,
                                           const Eigen::Matrix<double, 6, 6>&);

double add_lens_uncertainty_px(const CameraModel& camera, double predicted_px) {
  return std::hypot(predicted_px, camera.parameters().overlay_sigma_px.value_or(0.0));
}

}  // namespace penumbra
