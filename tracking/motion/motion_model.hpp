// Kalman filter for pose and velocity of a hand-held camera. Adapts the process noise
// (accelerations) to the innovations. The alignment combines image and prediction.
#pragma once

#include <cstdint>
#include <optional>

#include "core/geometry/transform.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

struct MotionPrediction {
  MapFromCamera T_map_camera;
  // Covariance of [nu; omega] in T_map_camera * exp([nu; omega]) [m, rad].
  Matrix6d covariance = Matrix6d::Zero();
  Vector6d velocity = Vector6d::Zero();  // [m/s, rad/s], camera frame
};

// Returns the prior of the velocity of a hand-held camera without a previous pose.
[[nodiscard]] VelocityPrior unknown_velocity();
// Returns the covariance of a hand-held pose extrapolated for `age_s` [m^2, rad^2].
[[nodiscard]] Matrix6d extrapolation_covariance(double age_s);

class MotionModel {
 public:
  void reset() { state_.reset(); }
  [[nodiscard]] bool has_state() const { return state_.has_value(); }
  [[nodiscard]] std::int64_t timestamp_ns() const { return state_->timestamp_ns; }

  // Starts from a pose of unknown motion.
  void start(std::int64_t timestamp_ns, const MapFromCamera& T_map_camera,
             const Matrix6d& covariance);
  // Requires a state that is not later than `timestamp_ns`.
  [[nodiscard]] MotionPrediction predict(std::int64_t timestamp_ns) const;
  // Returns the covariance of the velocity of predict(timestamp_ns), bounded by the accelerations
  // of a hand.
  [[nodiscard]] VelocityPrior velocity_prior(std::int64_t timestamp_ns) const;
  // Adapts the accelerations that velocity_prior() assumes to a velocity that was solved for with
  // that prior. Call before update().
  void adapt_accelerations(std::int64_t timestamp_ns, const VelocityEstimate& found);
  // Updates with an alignment's pose; `covariance` already combines it with predict(timestamp_ns).
  void update(std::int64_t timestamp_ns, const MapFromCamera& T_map_camera,
              const Matrix6d& covariance);

 private:
  struct State {
    std::int64_t timestamp_ns = 0;
    MapFromCamera pose;
    Vector6d velocity = Vector6d::Zero();  // linear [m/s], then angular [rad/s]
    Matrix6d P_pose = Matrix6d::Zero();    // covariance of the pose [m^2, rad^2]
    Matrix6d P_cross = Matrix6d::Zero();   // rows: velocity; columns: pose
    Matrix6d P_velocity = Matrix6d::Zero();
    // Spectral densities of the accelerations [m^2/s^3], [rad^2/s^3].
    double q_linear = 0.0;
    double q_angular = 0.0;
    // Squared accelerations that velocity_prior() assumes.
    double linear_m2_s4 = 0.0;
    double angular_rad2_s4 = 0.0;
  };
  [[nodiscard]] static State advanced(const State& from, std::int64_t timestamp_ns);

  std::optional<State> state_;
};

}  // namespace penumbra
