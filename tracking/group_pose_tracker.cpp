#include "tracking/group_pose_tracker.hpp"

#include <memory>

#include "core/evaluation/evaluation.hpp"
#include "core/propagate.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

CameraPose as_table(const MiddleFromCamera& pose) {
  return {pose.rotation(), pose.translation()};
}

GroupSighting sighting_of(PoseEstimate estimate, const TrackTimes& times) {
  GroupSighting seen;
  seen.status = estimate.status;
  seen.T_middle_camera = {estimate.T_table_camera.rotation(),
                          estimate.T_table_camera.translation()};
  seen.covariance = estimate.covariance;
  seen.reprojection_rms_px = estimate.reprojection_rms_px;
  seen.tags_used = estimate.tags_used;
  seen.tags_left_out = std::move(estimate.tags_left_out);
  seen.reason = std::move(estimate.reason);
  seen.times = times;
  return seen;
}

// A map of the group's tags alone, with the group's middle as origin.
Result<TagMap> map_of_group(const TagMap& tags, const std::string& group) {
  const auto T_middle_group = middle_of_group(tags, group).inverse();
  std::vector<MappedTag> own;
  for (const MappedTag& tag : tags.tags()) {
    if (tag.group != group) continue;
    MappedTag& copy = own.emplace_back(tag);
    const Transform<frame::Group, frame::Tag> T_group_tag(tag.T_table_tag.rotation(),
                                                          tag.T_table_tag.translation());
    const auto T_middle_tag = T_middle_group * T_group_tag;
    copy.T_table_tag = {T_middle_tag.rotation(), T_middle_tag.translation()};
    copy.group = kTableGroup;
  }
  return TagMap::make(std::move(own));
}

}  // namespace

Result<GroupPoseTracker> GroupPoseTracker::create(const CameraModel& camera, const TagMap& tags,
                                                  const std::string& group,
                                                  const TrackerOptions& options,
                                                  std::shared_ptr<TagSearch> search) {
  const Result<TagMap> own = map_of_group(tags, group);
  if (!own) return fail_in(fmt::format("group '{}'", group), own.error());
  Result<RigidTagTracker> tracker =
      RigidTagTracker::create(camera, *own, options, std::move(search));
  if (!tracker) return fail_in(fmt::format("group '{}'", group), tracker.error());
  return GroupPoseTracker(std::move(*tracker));
}

GroupSighting GroupPoseTracker::track(const Frame& frame, SharedFrame request,
                                      const std::optional<MiddleFromCamera>& hint) {
  if (hint) request.hint = as_table(*hint);
  TrackedFrame tracked = tracker_.track(frame, request);
  return sighting_of(std::move(tracked.pose), tracked.times);
}

GroupSighting GroupPoseTracker::locate(std::span<const TagDetection> detections) {
  return sighting_of(tracker_.locate(detections), {});
}

double overlay_distance_px(const CameraModel& camera, const MiddleFromCamera& a,
                           const MiddleFromCamera& b) {
  return overlay_difference(camera, as_table(a), as_table(b)).rms_px();
}

double predicted_overlay_px(const CameraModel& camera, const MiddleFromCamera& pose,
                            const Matrix6d& covariance) {
  return with_lens_error_px(camera, expected_overlay_error_px(camera, as_table(pose), covariance));
}

TableFromMiddle moved(const TableFromMiddle& place, const Vector6d& xi) {
  const CameraPose pose = perturbed({place.rotation(), place.translation()}, xi);
  return {pose.rotation(), pose.translation()};
}

Vector6d motion_between(const TableFromMiddle& from, const TableFromMiddle& to) {
  return perturbation_between({from.rotation(), from.translation()},
                              {to.rotation(), to.translation()});
}

}  // namespace penumbra
