// The last measured poses, and what they say of the motion since.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "core/camera/camera_model.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "core/geometry/transform.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

// How long a measured pose still says where the camera is, well enough to choose between two poses
// or to give a velocity [s].
inline constexpr double kPriorLifetime_s = 0.2;

// Motion of the camera in a frame, as perturbations of its pose per second.
struct CameraMotion {
  Vector6d velocity;
  Vector6d change;  // of the velocity since the frame before; the velocity itself after one step
  bool of_one_step = true;
};

class PoseHistory {
 public:
  // Begins a frame: poses that are not older than it are forgotten, because the clock jumped.
  void begin_frame(std::int64_t timestamp_ns);
  // Time since the frame before, which an exposure can't exceed [s]; 0: unknown.
  [[nodiscard]] double frame_interval_s() const { return frame_interval_s_; }

  // Adds the pose of the frame. `is_located`: it is not one of several that lie far apart.
  // `continues`: the next poses may be predicted from it.
  void add(std::int64_t timestamp_ns, const PoseEstimate& estimate, bool is_located,
           bool continues);

  // The tracked motion continued at constant velocity, as a rotation about an axis and a
  // translation in the camera's axes.
  [[nodiscard]] std::optional<CameraPose> predict(std::int64_t timestamp_ns) const;
  // The same while the last tracked pose is recent.
  [[nodiscard]] std::optional<CameraPose> recent_prediction(std::int64_t timestamp_ns) const;
  // The motion in a frame with this pose, as if the velocity changed evenly. It uses measured poses
  // only: a prediction may be missing, or another one.
  [[nodiscard]] std::optional<CameraMotion> motion_at(std::int64_t timestamp_ns,
                                                      const CameraPose& pose) const;
  // Whether the pose before is known well enough to take its motion for the camera's.
  [[nodiscard]] bool was_tracked() const { return measured_->tracked; }

  // The estimate of a frame without a measurement: the motion extrapolated for up to `hold_s`, or
  // lost.
  [[nodiscard]] PoseEstimate coast(const CameraModel& camera, std::int64_t timestamp_ns,
                                   double hold_s, std::string reason) const;

 private:
  struct TimedPose {
    std::int64_t timestamp_ns = 0;
    CameraPose pose;
    Matrix6d covariance = Matrix6d::Zero();
    bool tracked = false;
  };
  // The last two tracked poses.
  std::optional<TimedPose> last_, before_last_;
  // The last two measured poses, tracked or uncertain, that are located.
  std::optional<TimedPose> measured_, before_measured_;
  TrackStatus last_status_ = TrackStatus::tracked;  // of the last measured frame
  double frame_interval_s_ = 0.0;
  std::optional<std::int64_t> frame_before_ns_;
};

}  // namespace penumbra
