// Hand-held motion: the camera goes on as it went, with accelerations whose strength is learned
// from how far the last predictions were off. A Kalman filter on pose and velocity; the measurement
// itself (image and prediction weighed together) is the alignment's.
#pragma once

#include <cstdint>
#include <optional>

#include "core/geometry/transform.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

struct MotionPrediction {
  CameraPose T_table_camera;
  Matrix6d covariance = Matrix6d::Zero();  // of T_table_camera * exp([nu; omega]) [m, rad]
  Vector6d velocity = Vector6d::Zero();    // [m/s, rad/s], camera frame
};

// What a pose that is continued at constant velocity for `age_s` may be off by (covariance [m^2],
// [rad^2]): a hand changes its speed by about 2 m/s^2 and 10 rad/s^2 [1 sigma].
[[nodiscard]] Matrix6d unforeseen_motion(double age_s);

class MotionModel {
 public:
  // Forgets everything.
  void reset() { state_.reset(); }
  [[nodiscard]] bool has_state() const { return state_.has_value(); }
  [[nodiscard]] std::int64_t timestamp_ns() const { return state_->timestamp_ns; }

  // Starts from a pose with nothing known of the motion.
  void start(std::int64_t timestamp_ns, const CameraPose& T_table_camera,
             const Matrix6d& covariance);
  // Needs a state; `timestamp_ns` not before the state's.
  [[nodiscard]] MotionPrediction predict(std::int64_t timestamp_ns) const;
  // What was found at `timestamp_ns` when starting from predict(timestamp_ns): the pose and its
  // covariance, the prediction included.
  void update(std::int64_t timestamp_ns, const CameraPose& T_table_camera,
              const Matrix6d& covariance);

 private:
  struct State {
    std::int64_t timestamp_ns = 0;
    CameraPose pose;
    Vector6d velocity = Vector6d::Zero();  // linear [m/s], then angular [rad/s]
    Matrix6d P_pose = Matrix6d::Zero();    // squares of [m] and [rad]; the others accordingly
    Matrix6d P_cross = Matrix6d::Zero();   // velocity (rows), pose (columns)
    Matrix6d P_velocity = Matrix6d::Zero();
    // Strength of the accelerations: spectral density, [m^2/s^3] and [rad^2/s^3].
    double q_linear = 0.0;
    double q_angular = 0.0;
  };
  [[nodiscard]] State advanced(std::int64_t timestamp_ns) const;

  std::optional<State> state_;
};

}  // namespace penumbra
