#include "app/window/stall_display.hpp"

#include "core/units.hpp"

namespace penumbra {

std::optional<TrackedFrame> StallDisplay::frame_to_show(std::int64_t stall_ns) {
  if (!last_) return std::nullopt;
  TrackedFrame tracked = *last_;
  // A repeated frame has no new measurements.
  tracked.pose.tags_used = 0;
  bool gone = true;
  const auto hold = [&gone, stall_ns](auto& pose) {
    if (!pose.has_pose()) return;
    pose.age_s += seconds(stall_ns);
    if (pose.status != TrackStatus::held) pose.held_from = pose.status;
    pose.status = pose.age_s > kHoldSeconds ? TrackStatus::lost : TrackStatus::held;
    gone = gone && pose.status == TrackStatus::lost;
  };
  hold(tracked.pose);
  for (GroupEstimate& group : tracked.groups) hold(group);
  // This is the last drawing of the frame. Releases its buffer, because a driver that lost its
  // camera needs all buffers back before it accepts the camera again.
  if (gone) last_.reset();
  tracked.pose.reason = {PoseCause::no_complete_frame};
  return tracked;
}

}  // namespace penumbra
