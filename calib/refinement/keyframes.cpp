#include "calib/refinement/keyframes.hpp"

#include <algorithm>
#include <utility>

#include "core/evaluation/evaluation.hpp"
#include "core/geometry/group_pose.hpp"

namespace penumbra {
namespace {

// First minimum distance between two cameras, as a fraction of their distance from the tags, and
// its growth. See docs/tracking.md#refining-the-map.
constexpr double kMinDistance = 0.03;
constexpr double kDistanceGrowth = 1.5;
// Maximum motion of the overlay between two frames [px]; blur makes edges of faster ones
// inaccurate.
constexpr double kMaxMotion_px = 25.0;
constexpr int kHeldOutEvery = 4;

// velocity_at() returns zero for an unknown velocity.
std::optional<Vector6d> known_velocity(const Vector6d& velocity) {
  return velocity.isZero(0.0) ? std::nullopt : std::optional(velocity);
}

}  // namespace

MapKeyframes::MapKeyframes(const CameraModel& camera, const TagMap& tags)
    : camera_(camera), min_distance_(kMinDistance) {
  int count = 0;
  for (const MappedTag& tag : tags.tags()) {
    if (tag.group != kTableGroup) continue;
    middle_m_ += tag.T_table_tag.translation();
    ++count;
  }
  middle_m_ /= std::max(count, 1);
}

bool MapKeyframes::is_far_from_kept(const Eigen::Vector3d& camera_m) const {
  return std::ranges::all_of(kept_, [&](const auto& keyframe) {
    const double nearer_m =
        std::min((camera_m - middle_m_).norm(), (keyframe->camera_m - middle_m_).norm());
    return (camera_m - keyframe->camera_m).norm() > min_distance_ * nearer_m;
  });
}

void MapKeyframes::thin_out() {
  min_distance_ *= kDistanceGrowth;
  const KeyframeList before = std::exchange(kept_, {});
  for (const auto& keyframe : before) {
    if (is_far_from_kept(keyframe->camera_m)) kept_.push_back(keyframe);
  }
}

// Replaces the latest keyframe, if it is the previous frame, by one with a central velocity. Others
// may read the replaced one meanwhile.
void MapKeyframes::complete_latest(const TimedPose& here) {
  const auto before = std::exchange(before_latest_, std::nullopt);
  if (!before) return;
  auto completed = std::make_shared<MapKeyframe>(*kept_.back());
  completed->velocity = known_velocity(velocity_at(&*before, *previous_, &here));
  kept_.back() = std::move(completed);
}

bool MapKeyframes::add(ImageView luma, std::int64_t timestamp_ns,
                       const CameraPose& T_table_camera) {
  if (luma.width != camera_.width() || luma.height != camera_.height() ||
      !T_table_camera.is_finite())
    return false;
  const TimedPose here{timestamp_ns, as_map_pose(T_table_camera)};
  complete_latest(here);
  const std::optional<TimedPose> previous = std::exchange(previous_, here);
  // Without the previous pose, the speed of the camera is unknown.
  if (!previous ||
      !(overlay_difference(camera_, *here.pose, *previous->pose).rms_px() < kMaxMotion_px))
    return false;
  const Eigen::Vector3d& camera_m = here.pose->translation();
  if (kept_.size() >= kMaxKeyframes) thin_out();
  if (kept_.size() >= kMaxKeyframes || !is_far_from_kept(camera_m)) return false;
  auto keyframe = std::make_shared<MapKeyframe>();
  keyframe->size = {luma.width, luma.height};
  keyframe->camera_m = camera_m;
  keyframe->velocity = known_velocity(velocity_at(&*previous, here, nullptr));
  keyframe->held_out = ++added_ % kHeldOutEvery == 0;
  keyframe->pixels.reserve(static_cast<std::size_t>(luma.width) *
                           static_cast<std::size_t>(luma.height));
  for (int y = 0; y < luma.height; ++y)
    keyframe->pixels.insert(keyframe->pixels.end(), luma.row(y), luma.row(y) + luma.width);
  kept_.push_back(std::move(keyframe));
  before_latest_ = previous;
  if (kept_.size() < due_) return false;
  due_ = std::min(due_ + kRefinementInterval, kMaxKeyframes);
  return true;
}

}  // namespace penumbra
