// Tracks the camera over one group of tags beside the table.
//
// The classes below are typed for the table, which they mostly track. What they say of another
// group is typed here, once: as the pose of the camera over the group's middle.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/frame.hpp"
#include "tracking/detection/pose_refiner.hpp"
#include "tracking/rigid_tag_tracker.hpp"

namespace penumbra {

using MiddleFromCamera = Transform<frame::GroupMiddle, frame::Camera>;
using TableFromMiddle = Transform<frame::Table, frame::GroupMiddle>;

// The camera over a group's middle in one frame. Fields as in PoseEstimate.
struct GroupSighting {
  TrackStatus status = TrackStatus::lost;
  MiddleFromCamera T_middle_camera;
  Matrix6d covariance = Matrix6d::Zero();
  double reprojection_rms_px = 0.0;
  int tags_used = 0;
  std::vector<int> tags_left_out;
  std::string reason;
  TrackTimes times;
};

class GroupPoseTracker {
 public:
  // The map must have the group.
  [[nodiscard]] static Result<GroupPoseTracker> create(const CameraModel& camera,
                                                       const TagMap& tags, const std::string& group,
                                                       const TrackerOptions& options,
                                                       std::shared_ptr<TagSearch> search);

  // As RigidTagTracker's. `hint`: where the camera may be over the group.
  [[nodiscard]] GroupSighting track(const Frame& frame, SharedFrame request,
                                    const std::optional<MiddleFromCamera>& hint);
  [[nodiscard]] GroupSighting locate(std::span<const TagDetection> detections);

 private:
  explicit GroupPoseTracker(RigidTagTracker tracker) : tracker_(std::move(tracker)) {}
  RigidTagTracker tracker_;
};

// RMS distance of the overlay on a group's middle between two poses [px].
[[nodiscard]] double overlay_distance_px(const CameraModel& camera, const MiddleFromCamera& a,
                                         const MiddleFromCamera& b);
// Predicted error of that overlay, the lens's included [px], 1 sigma.
[[nodiscard]] double predicted_overlay_px(const CameraModel& camera, const MiddleFromCamera& pose,
                                          const Matrix6d& covariance);

// T exp(xi), and the xi between two, to first order (pose_refiner.hpp), for places on the table.
[[nodiscard]] TableFromMiddle moved(const TableFromMiddle& place, const Vector6d& xi);
[[nodiscard]] Vector6d motion_between(const TableFromMiddle& from, const TableFromMiddle& to);

}  // namespace penumbra
