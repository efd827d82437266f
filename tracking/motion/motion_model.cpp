#include "tracking/motion/motion_model.hpp"

#include <algorithm>
#include <cmath>

#include "core/assert.hpp"
#include "core/units.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

// Random accelerations of a hand, given as the displacement (1 sigma) that they cause in 1/30 s.
constexpr double kFrame_s = 1.0 / 30.0;
constexpr double density(double displacement) {
  return 3.0 * displacement * displacement / (kFrame_s * kFrame_s * kFrame_s);
}
constexpr double kStartLinear_m = 0.010, kMinLinear_m = 0.0003, kMaxLinear_m = 0.030;
constexpr double kStartAngular_rad = radians(1.0);
constexpr double kMinAngular_rad = radians(0.03);
constexpr double kMaxAngular_rad = radians(3.0);
// Speed of a hand-held camera with unknown motion (1 sigma).
constexpr double kLinearSpeed_m_s = 0.7;
constexpr double kAngularSpeed_rad_s = 2.0;
// Typical speeds and accelerations (1 sigma) of a hand-held camera, and the smallest error of a
// predicted velocity. See docs/tracking.md#rolling-shutter.
constexpr double kTypicalLinear_m_s = 0.1, kTypicalAngular_rad_s = 0.5;
constexpr double kStartLinear_m_s2 = 1.0, kMinLinear_m_s2 = 0.05, kMaxLinear_m_s2 = 2.0;
constexpr double kStartAngular_rad_s2 = 20.0, kMinAngular_rad_s2 = 1.0, kMaxAngular_rad_s2 = 40.0;
constexpr double kMinLinear_m_s = 0.01, kMinAngular_rad_s = 0.03;

// Adapts q by squared innovation / expected value: at once if the ratio is above 1, else slowly.
double adapted(double q, double ratio, double low, double high) {
  const double factor =
      ratio > 1.0 ? std::min(ratio, 1000.0) : std::pow(std::max(ratio, 0.05), 0.1);
  return std::clamp(q * factor, low, high);
}

}  // namespace

Matrix6d extrapolation_covariance(double age_s) {
  constexpr double kLinear_m_s2 = 2.0;
  constexpr double kAngular_rad_s2 = 10.0;
  return covariance_of(0.5 * kLinear_m_s2 * age_s * age_s, 0.5 * kAngular_rad_s2 * age_s * age_s);
}

VelocityPrior unknown_velocity() {
  return {covariance_of(kTypicalLinear_m_s, kTypicalAngular_rad_s)};
}

void MotionModel::start(std::int64_t timestamp_ns, const MapFromCamera& T_map_camera,
                        const Matrix6d& covariance) {
  PENUMBRA_ASSERT(T_map_camera.is_finite() && covariance.allFinite());
  State state;
  state.timestamp_ns = timestamp_ns;
  state.pose = T_map_camera;
  state.P_pose = covariance;
  state.P_velocity = covariance_of(kLinearSpeed_m_s, kAngularSpeed_rad_s);
  state.q_linear = density(kStartLinear_m);
  state.q_angular = density(kStartAngular_rad);
  state.linear_m2_s4 = kStartLinear_m_s2 * kStartLinear_m_s2;
  state.angular_rad2_s4 = kStartAngular_rad_s2 * kStartAngular_rad_s2;
  state_ = state;
}

MotionModel::State MotionModel::advanced(const State& from, std::int64_t timestamp_ns) {
  PENUMBRA_ASSERT(timestamp_ns >= from.timestamp_ns);
  State next = from;
  const double dt = seconds(timestamp_ns - from.timestamp_ns);
  next.timestamp_ns = timestamp_ns;
  next.pose = perturbed(from.pose, from.velocity * dt);
  Vector6d q;
  q << from.q_linear, from.q_linear, from.q_linear, from.q_angular, from.q_angular, from.q_angular;
  const Matrix6d Q = q.asDiagonal();
  const Matrix6d& C = from.P_cross;
  next.P_pose += dt * (C + C.transpose()) + dt * dt * from.P_velocity + dt * dt * dt / 3.0 * Q;
  next.P_cross += dt * from.P_velocity + dt * dt / 2.0 * Q;
  next.P_velocity += dt * Q;
  return next;
}

MotionPrediction MotionModel::predict(std::int64_t timestamp_ns) const {
  PENUMBRA_ASSERT(state_);
  const State next = advanced(*state_, timestamp_ns);
  return {next.pose, next.P_pose, next.velocity};
}

VelocityPrior MotionModel::velocity_prior(std::int64_t timestamp_ns) const {
  PENUMBRA_ASSERT(state_);
  const State next = advanced(*state_, timestamp_ns);
  State bounded = *state_;
  const double dt = seconds(timestamp_ns - bounded.timestamp_ns);
  bounded.q_linear = std::min(bounded.q_linear, bounded.linear_m2_s4 * dt);
  bounded.q_angular = std::min(bounded.q_angular, bounded.angular_rad2_s4 * dt);
  const State by_hand = advanced(bounded, timestamp_ns);
  // The pose of this frame determines the velocity up to the change of velocity since the previous
  // frame.
  const auto explained = [](const State& state) -> Matrix6d {
    return state.P_cross * inverse_of_spd(state.P_pose) * state.P_cross.transpose();
  };
  const Matrix6d covariance = explained(next) + by_hand.P_velocity - explained(by_hand) +
                              covariance_of(kMinLinear_m_s, kMinAngular_rad_s);
  if (!covariance.allFinite() || !next.P_cross.allFinite()) return unknown_velocity();
  return {0.5 * (covariance + covariance.transpose()), next.P_cross};
}

void MotionModel::adapt_accelerations(std::int64_t timestamp_ns, const VelocityEstimate& found) {
  PENUMBRA_ASSERT(state_);
  const Matrix6d learned = velocity_prior(timestamp_ns).covariance - found.covariance;
  const Vector6d change = found.velocity - state_->velocity;
  const auto adapt = [&](double& squared, int first, double low, double high) {
    const double expected = learned.diagonal().segment<3>(first).sum();
    if (!(expected > 0.0)) return;
    const double ratio = change.segment<3>(first).squaredNorm() / expected;
    squared = adapted(squared, ratio, low * low, high * high);
  };
  adapt(state_->linear_m2_s4, 0, kMinLinear_m_s2, kMaxLinear_m_s2);
  adapt(state_->angular_rad2_s4, 3, kMinAngular_rad_s2, kMaxAngular_rad_s2);
}

void MotionModel::update(std::int64_t timestamp_ns, const MapFromCamera& T_map_camera,
                         const Matrix6d& covariance) {
  PENUMBRA_ASSERT(state_ && T_map_camera.is_finite() && covariance.allFinite());
  State next = advanced(*state_, timestamp_ns);
  const Vector6d moved = perturbation_between(next.pose, T_map_camera);
  // The correction of the pose also corrects the velocity, by the cross-covariance.
  const Matrix6d gain = next.P_cross * inverse_of_spd(next.P_pose);
  const Matrix6d learned = next.P_pose - covariance;  // E[moved moved^T] if q is right
  const auto ratio = [&](int first) {
    const double expected = learned.diagonal().segment<3>(first).sum();
    const double found = moved.segment<3>(first).squaredNorm();
    // Leaves q nearly unchanged if the image adds no information to the prediction.
    return expected > 0.1 * next.P_pose.diagonal().segment<3>(first).sum() ? found / expected
                                                                           : 0.999;
  };
  next.q_linear = adapted(next.q_linear, ratio(0), density(kMinLinear_m), density(kMaxLinear_m));
  next.q_angular =
      adapted(next.q_angular, ratio(3), density(kMinAngular_rad), density(kMaxAngular_rad));
  next.velocity += gain * moved;
  next.P_velocity -= gain * learned * gain.transpose();
  next.P_cross = gain * covariance;
  next.P_pose = covariance;
  next.P_velocity = 0.5 * (next.P_velocity + next.P_velocity.transpose().eval());
  next.pose = T_map_camera;
  state_ = next;
}

}  // namespace penumbra
