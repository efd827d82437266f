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
  bool of_one_step = true;
};

// PoseEstimate over the map that a tracker is given.
struct MapPoseEstimate : EstimatedPose {
  MapFromCamera T_map_camera;
  double ambiguity_ratio = 0.0;
};

class PoseHistory {
 public:
  // Begins a frame; discards newer poses, which means that the clock jumped back.
  void begin_frame(std::int64_t timestamp_ns);
  // Time since the previous frame [s], an upper limit of the exposure; 0: unknown.
  [[nodiscard]] double frame_interval_s() const { return frame_interval_s_; }

  // Adds a pose. `is_located`: not one of several far apart. `continues`: usable by predict().
  void add(std::int64_t timestamp_ns, const MapPoseEstimate& estimate, bool is_located,
           bool continues);

  // The tracked motion continued at constant velocity.
  [[nodiscard]] std::optional<MapFromCamera> predict(std::int64_t timestamp_ns) const;
  // predict() while its last pose is recent; nullopt afterwards.
  [[nodiscard]] std::optional<MapFromCamera> recent_prediction(std::int64_t timestamp_ns) const;
  // Motion in a frame with this pose, by measured poses and constant acceleration.
  [[nodiscard]] std::optional<CameraMotion> motion_at(std::int64_t timestamp_ns,
                                                      const MapFromCamera& pose) const;
  // Returns true if the latest located pose was tracked. There must be one.
  [[nodiscard]] bool was_tracked() const { return located_->tracked; }

  // Extrapolates a frame without a measurement for up to `hold_s`; then lost.
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
  TrackStatus last_status_ = TrackStatus::tracked;  // of the latest measured frame
  double frame_interval_s_ = 0.0;
  std::optional<std::int64_t> previous_frame_ns_;
};

}  // namespace penumbra
