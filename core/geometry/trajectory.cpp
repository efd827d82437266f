#include "core/geometry/trajectory.hpp"

#include <algorithm>
#include <cmath>

#include "core/assert.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

Eigen::Vector3d rotation_vector(const Eigen::Quaterniond& rotation) {
  const Eigen::AngleAxisd turn(rotation.w() < 0.0 ? Eigen::Quaterniond(-rotation.coeffs())
                                                  : rotation);
  return turn.angle() * turn.axis();
}

Eigen::Quaterniond turned_by(const Eigen::Vector3d& vector) {
  const double angle = vector.norm();
  if (angle < 1e-12) return Eigen::Quaterniond::Identity();
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, vector / angle));
}

// Returns d v / dt while exp(v) rotates at the body rate `omega`, by the inverse right Jacobian of
// SO(3) (Chirikjian, Stochastic Models II, 10.86).
Eigen::Vector3d rate_of_vector(const Eigen::Vector3d& v, const Eigen::Vector3d& omega) {
  const double angle = v.norm();
  const double factor = angle < 1e-4 ? 1.0 / 12.0
                                     : 1.0 / (angle * angle) - (1.0 + std::cos(angle)) /
                                                                   (2.0 * angle * std::sin(angle));
  const Eigen::Matrix3d W = skew(v);
  return omega + 0.5 * (W * omega) + factor * (W * (W * omega));
}

struct Velocity {
  Eigen::Vector3d linear = Eigen::Vector3d::Zero();   // [m/s], table frame
  Eigen::Vector3d angular = Eigen::Vector3d::Zero();  // [rad/s], camera frame
};

// Returns the mean velocity from pose i - 1 to i + 1; pose i replaces a missing neighbour.
Velocity velocity_at(const std::vector<StampedPose>& poses, std::size_t i) {
  const StampedPose& before = poses[i > 0 ? i - 1 : i];
  const StampedPose& after = poses[std::min(i + 1, poses.size() - 1)];
  const double gap_s = seconds(after.timestamp_ns - before.timestamp_ns);
  if (!(gap_s > 0.0)) return {};
  return {(after.T_table_camera.translation() - before.T_table_camera.translation()) / gap_s,
          rotation_vector(before.T_table_camera.rotation().conjugate() *
                          after.T_table_camera.rotation()) /
              gap_s};
}

CameraPose extrapolated(const CameraPose& pose, const Velocity& velocity, double ahead_s) {
  return {pose.rotation() * turned_by(ahead_s * velocity.angular),
          pose.translation() + ahead_s * velocity.linear};
}

}  // namespace

CameraPose interpolate_pose(const Trajectory& trajectory, std::int64_t timestamp_ns) {
  const std::vector<StampedPose>& poses = trajectory.poses;
  PENUMBRA_ASSERT(!poses.empty());
  const auto later = std::ranges::upper_bound(poses, timestamp_ns, {}, &StampedPose::timestamp_ns);
  if (later == poses.begin() || later == poses.end()) {
    const std::size_t end = later == poses.begin() ? 0 : poses.size() - 1;
    return extrapolated(poses[end].T_table_camera, velocity_at(poses, end),
                        seconds(timestamp_ns - poses[end].timestamp_ns));
  }
  const auto i = static_cast<std::size_t>(later - poses.begin()) - 1;
  const CameraPose& begin = poses[i].T_table_camera;
  const CameraPose& end = poses[i + 1].T_table_camera;
  const double gap_s = seconds(poses[i + 1].timestamp_ns - poses[i].timestamp_ns);
  const double u = seconds(timestamp_ns - poses[i].timestamp_ns) / gap_s;
  const Velocity v0 = velocity_at(poses, i);
  const Velocity v1 = velocity_at(poses, i + 1);
  // Cubic Hermite interpolation from 0 to `change`, with rates rate0 and rate1 at the ends.
  const auto cubic = [&](const Eigen::Vector3d& change, const Eigen::Vector3d& rate0,
                         const Eigen::Vector3d& rate1) -> Eigen::Vector3d {
    return u * u * (3.0 - 2.0 * u) * change +
           gap_s * (u * (1.0 - u) * (1.0 - u) * rate0 - u * u * (1.0 - u) * rate1);
  };
  const Eigen::Vector3d turn = rotation_vector(begin.rotation().conjugate() * end.rotation());
  constexpr double kMaxTurn_rad = 2.5;  // between two poses; a cubic is ambiguous above it
  const Eigen::Vector3d vector = turn.norm() < kMaxTurn_rad
                                     ? cubic(turn, v0.angular, rate_of_vector(turn, v1.angular))
                                     : Eigen::Vector3d(u * turn);
  return {
      begin.rotation() * turned_by(vector),
      begin.translation() + cubic(end.translation() - begin.translation(), v0.linear, v1.linear)};
}

const StampedPose* Trajectory::at(std::int64_t timestamp_ns, std::int64_t tolerance_ns) const {
  const auto after = std::ranges::lower_bound(poses, timestamp_ns, {}, &StampedPose::timestamp_ns);
  const auto distance = [&](const StampedPose& pose) {
    return distance_ns(pose.timestamp_ns, timestamp_ns);
  };
  const StampedPose* best = nullptr;
  if (after != poses.end()) best = &*after;
  if (after != poses.begin() && (best == nullptr || distance(*(after - 1)) <= distance(*best)))
    best = &*(after - 1);
  if (best == nullptr || tolerance_ns < 0 ||
      distance(*best) > static_cast<std::uint64_t>(tolerance_ns))
    return nullptr;
  return best;
}

}  // namespace penumbra
