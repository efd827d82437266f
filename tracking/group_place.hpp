// Pose of a group of tags on the table: averaged while it rests, extrapolated while it is hidden.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>

#include "core/camera/camera_model.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "tracking/detection/pose_refiner.hpp"
#include "tracking/motion/pose_history.hpp"
#include "tracking/tracked_frame.hpp"

namespace penumbra {

using MiddleFromCamera = Transform<frame::GroupMiddle, frame::Camera>;
using TableFromMiddle = Transform<frame::Table, frame::GroupMiddle>;

// Convert poses of a group's tracker, whose map frame is the group's middle.
[[nodiscard]] inline MiddleFromCamera over_middle(const MapPoseEstimate& seen) {
  return {seen.T_map_camera.rotation(), seen.T_map_camera.translation()};
}
[[nodiscard]] inline MapFromCamera as_map_pose(const MiddleFromCamera& T_middle_camera) {
  return {T_middle_camera.rotation(), T_middle_camera.translation()};
}

// Returns true if the pose was measured in its frame.
[[nodiscard]] inline bool is_measured(TrackStatus status) {
  return status == TrackStatus::tracked || status == TrackStatus::uncertain;
}

class GroupPlace {
 public:
  // Starts at the group's pose in the map.
  GroupPlace(std::string name, const Transform<frame::Group, frame::GroupMiddle>& T_group_middle)
      : name_(std::move(name)),
        T_group_middle_(T_group_middle),
        shown_(GroupPose() * T_group_middle) {}

  // Returns the displayed pose, within 0.25 px of the average.
  [[nodiscard]] const TableFromMiddle& shown() const { return shown_; }
  // Returns true if the latest measurement is older than this time, or there is no measurement.
  [[nodiscard]] bool is_older_than(std::int64_t timestamp_ns) const {
    return !found_ || found_->timestamp_ns < timestamp_ns;
  }

  // Updates with `seen`, a frame's estimate by the group's tracker. `hold_s`: maximum time to
  // extrapolate a hidden group.
  [[nodiscard]] GroupEstimate update(const CameraModel& camera, double hold_s,
                                     std::int64_t timestamp_ns, const PoseEstimate& table_pose,
                                     const MapPoseEstimate& seen);

 private:
  struct Place {
    std::int64_t timestamp_ns = 0;
    TableFromMiddle T_table_middle;
    Matrix6d covariance = Matrix6d::Zero();  // covariance of xi in T_table_middle * exp(xi)
  };
  // Adds a measurement: averages it with found_ if both agree, otherwise replaces found_. Returns
  // false, and does neither, if it is uncertain and disagrees.
  bool add_measurement(const CameraModel& camera, const Place& now, bool uncertain,
                       const CameraPose& T_table_camera);
  [[nodiscard]] GroupEstimate measured(const CameraModel& camera, const PoseEstimate& table_pose,
                                       const MapPoseEstimate& seen);
  [[nodiscard]] GroupEstimate coasting(const CameraModel& camera, double hold_s,
                                       std::int64_t timestamp_ns, const PoseEstimate& table_pose,
                                       PoseReason reason) const;

  std::string name_;
  Transform<frame::Group, frame::GroupMiddle> T_group_middle_;
  std::optional<Place> found_;  // latest measurement; averaged while the group rests
  TableFromMiddle shown_;
  TrackStatus last_status_ = TrackStatus::tracked;  // status of the latest measurement
  bool rests_ = false;
  Vector6d velocity_ = Vector6d::Zero();  // motion of the group's middle, in its axes [m/s, rad/s]
};

}  // namespace penumbra
