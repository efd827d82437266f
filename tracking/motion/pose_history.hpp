// The latest measured poses and the motion between them.
#pragma once

#include <cstdint>
#include <optional>

#include "core/camera/camera_model.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "core/geometry/transform.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

// Maximum age of a pose that is used to choose between two poses or to compute a velocity [s].
inline constexpr double kPriorLifetime_s = 0.2;

// Motion of the camera in a frame, as perturbations of its pose per second.
struct CameraMotion {
  Vector6d velocity;
  Vector6d change;  // velocity change since the previous frame; after one step, the velocity itself
  bool of_one_step = true;  // only two poses give the motion
};

// Estimate of the camera's pose in a tracker's map frame.
struct MapPoseEstimate : EstimatedPose {
  MapFromCamera T_map_camera;
  double ambiguity_ratio = 0.0;
};

class PoseHistory {
 public:
  // Begins a frame; discards the poses if they are newer, because the clock jumped back.
  void begin_frame(std::int64_t timestamp_ns);
  // Returns the time since the previous frame [s], an upper limit of the exposure; 0: unknown.
  [[nodiscard]] double frame_interval_s() const { return frame_interval_s_; }

  // Adds a pose. `is_located`: no distant pose is possible. `continues`: predict() may use it.
  void add(std::int64_t timestamp_ns, const MapPoseEstimate& estimate, bool is_located,
           bool continues);

  // Returns the pose predicted at constant velocity.
  [[nodiscard]] std::optional<MapFromCamera> predict(std::int64_t timestamp_ns) const;
  // Returns predict() if the latest pose is younger than kPriorLifetime_s, otherwise nullopt.
  [[nodiscard]] std::optional<MapFromCamera> recent_prediction(std::int64_t timestamp_ns) const;
  // Returns the motion in a frame with this pose, by measured poses and constant acceleration.
  [[nodiscard]] std::optional<CameraMotion> motion_at(std::int64_t timestamp_ns,
                                                      const MapFromCamera& pose) const;
  // Returns true if the latest located pose, which must exist, was tracked.
  [[nodiscard]] bool was_tracked() const { return located_->tracked; }

  // Extrapolates the pose of a frame without a measurement; lost after `hold_s`.
  [[nodiscard]] MapPoseEstimate coast(const CameraModel& camera, std::int64_t timestamp_ns,
                                      double hold_s, PoseReason reason) const;

 private:
  struct TimedPose {
    std::int64_t timestamp_ns = 0;
    MapFromCamera pose;
    Matrix6d covariance = Matrix6d::Zero();
    bool tracked = false;
  };
  // The latest two poses for predict().
  std::optional<TimedPose> last_, before_last_;
  // The latest two located poses, for motion_at(); tracked or uncertain.
  std::optional<TimedPose> located_, before_located_;
  TrackStatus last_status_ = TrackStatus::tracked;  // status of the latest measured frame
  double frame_interval_s_ = 0.0;
  std::optional<std::int64_t> previous_frame_ns_;
};

}  // namespace penumbra
