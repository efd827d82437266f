#include "calib/refinement/residual_watch.hpp"

#include <fmt/core.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string_view>
#include <utility>

#include "core/evaluation/evaluation.hpp"
#include "core/propagate.hpp"
#include "tracking/pose_confidence.hpp"

namespace penumbra {
namespace {

// The time of a test grows with the cube of the number of tags.
constexpr std::size_t kMaxTags = 24;
constexpr double kOtherView_px = 5.0;  // overlay difference to the previous measured frame
constexpr std::size_t kDecisiveFrames = 32;
// A test takes place at these numbers of measured frames.
constexpr auto kTests = std::to_array<std::size_t>({8, 12, 16, 24, 32, 48, 64});
static_assert(kTests.front() == kMinResidualFrames && kTests.back() == ResidualWatch::kMaxFrames);

// Returns up to `count` tags of the table, each as far as possible from those before it.
std::vector<MappedTag> spread_tags(const TagMap& map, std::size_t count) {
  std::vector<MappedTag> tags;
  for (const MappedTag& tag : map.tags()) {
    if (tag.group == kTableGroup) tags.push_back(tag);
  }
  std::vector<double> distance(tags.size(), std::numeric_limits<double>::infinity());
  for (std::size_t chosen = 0; chosen + 1 < tags.size(); ++chosen) {
    for (std::size_t i = chosen + 1; i < tags.size(); ++i) {
      distance[i] = std::min(
          distance[i],
          (tags[i].T_table_tag.translation() - tags[chosen].T_table_tag.translation()).norm());
    }
    const auto farthest = std::max_element(
        distance.begin() + static_cast<std::ptrdiff_t>(chosen) + 1, distance.end());
    const auto at = static_cast<std::size_t>(farthest - distance.begin());
    std::swap(tags[chosen + 1], tags[at]);
    std::swap(distance[chosen + 1], distance[at]);
  }
  if (tags.size() > count) tags.resize(count);
  return tags;
}

// Returns true if the pose is good enough to find the tags. Tags that are inconsistent with the map
// are what this class looks for.
bool is_located(const PoseEstimate& pose) {
  const PoseCause cause = pose.reason.cause;
  return pose.tags_used > 0 &&
         (pose.status == TrackStatus::tracked ||
          (pose.status == TrackStatus::uncertain &&
           (cause == PoseCause::inconsistent_tags || cause == PoseCause::uncertain_map)));
}

// Returns the causes that are significant, or else those that are possible.
Suspects suspects_of(const ResidualCauses& causes) {
  const auto all = [&](bool CauseEvidence::*kind) {
    const auto is = [&](ErrorCause cause) { return causes.of(cause).*kind; };
    return Suspects{is(ErrorCause::paper), is(ErrorCause::lens), is(ErrorCause::shutter)};
  };
  Suspects significant = all(&CauseEvidence::significant);
  if (significant == Suspects{}) return all(&CauseEvidence::possible);
  significant.certain = true;
  return significant;
}

}  // namespace

ResidualWatch::ResidualWatch(const CameraModel& camera, std::vector<MappedTag> tags,
                             TagCornerMeter meter)
    : camera_(camera), tags_(std::move(tags)), meter_(std::move(meter)) {}

Result<std::unique_ptr<ResidualWatch>> ResidualWatch::create(const CameraModel& camera,
                                                             const TagMap& map) {
  std::vector<MappedTag> tags = spread_tags(map, kMaxTags);
  PENUMBRA_TRY(auto meter, TagCornerMeter::create(camera, tags));
  return std::unique_ptr<ResidualWatch>(
      new ResidualWatch(camera, std::move(tags), std::move(meter)));
}

Result<void> ResidualWatch::restart(const CameraModel& camera, const TagMap& map) {
  std::vector<MappedTag> tags = spread_tags(map, kMaxTags);
  PENUMBRA_TRY(meter_, TagCornerMeter::create(camera, tags));
  camera_ = camera;
  tags_ = std::move(tags);
  frames_.clear();
  measured_.reset();
  failures_ = 0;
  latest_.reset();
  error_px_ = 0.0;
  map_sigma_m_ = 0.0;
  latest_causes_.reset();
  const std::lock_guard lock(mutex_);
  found_.reset();
  return {};
}

std::vector<std::string> ResidualWatch::observe(TrackedFrame& tracked) {
  std::vector<std::string> notices;
  const Frame& frame = tracked.frame;
  TimedPose here{frame.timestamp_ns, std::nullopt};
  if (is_located(tracked.pose)) here.pose = as_map_pose(tracked.pose.T_table_camera);
  if (latest_) {
    const TimedPose* before = latest_->before ? &*latest_->before : nullptr;
    frames_.back().velocity = velocity_at(before, latest_->here, &here);
    latest_.reset();
    if (std::ranges::find(kTests, frames_.size()) != kTests.end()) notices = test();
  }
  if (here.pose && wants_frames() && shows_another_view(*here.pose)) measure(frame, here);
  previous_ = here;
  add_error(tracked.pose);
  return notices;
}

bool ResidualWatch::wants_frames() const {
  return tags_.size() >= kMinResidualTags && frames_.size() < kMaxFrames && failures_ < kMaxFrames;
}

bool ResidualWatch::shows_another_view(const MapFromCamera& pose) const {
  return !measured_ || overlay_difference(camera_, pose, *measured_).rms_px() >= kOtherView_px;
}

void ResidualWatch::measure(const Frame& frame, const TimedPose& here) {
  const TimedPose* before = previous_ ? &*previous_ : nullptr;
  FrameCorners corners =
      meter_.measure(luma(frame, scratch_), *here.pose, velocity_at(before, here, nullptr));
  measured_ = here.pose;
  if (corners.tags.size() < kMinResidualTags) {
    ++failures_;
    return;
  }
  frames_.push_back(std::move(corners));
  latest_ = Neighbours{previous_, here};
}

std::vector<std::string> ResidualWatch::test() {
  const ResidualCauses causes = find_residual_causes(camera_, tags_, frames_);
  latest_causes_ = causes;
  const bool any = causes.pose_px > 0.0 && std::isfinite(causes.pose_px);
  // Few frames may fail to confirm what fewer frames have shown.
  if (!any && frames_.size() < kDecisiveFrames) return {};
  error_px_ = any ? causes.pose_px : 0.0;
  suspects_ = suspects_of(causes);
  map_sigma_m_ = any && causes.of(ErrorCause::paper).significant
                     ? std::hypot(causes.sizes.off_flat_m, causes.sizes.in_plane_m) / std::sqrt(3.0)
                     : 0.0;
  {
    const std::lock_guard lock(mutex_);
    found_ = any ? std::optional(causes) : std::nullopt;
  }
  return any ? new_notices(causes) : std::vector<std::string>();
}

std::vector<std::string> ResidualWatch::new_notices(const ResidualCauses& causes) {
  std::vector<std::string> notices;
  const double given_row_s = camera_.parameters().rolling_shutter_row_s.value_or(0.0);
  bool significant = false;
  for (std::size_t i = 0; i < kErrorCauses; ++i) {
    if (!causes.evidence[i].significant) continue;
    significant = true;
    if (std::exchange(noticed_[i], true)) continue;
    notices.push_back(fmt::format("{} (displaces the overlay by about {:.1f} px)",
                                  advice(static_cast<ErrorCause>(i), causes.sizes, given_row_s),
                                  causes.evidence[i].overlay_px));
  }
  if (significant || std::exchange(noticed_unclear_, true)) return notices;
  notices.push_back(fmt::format(
      "the tag corners have a systematic residual of {:.2f} px, which displaces the overlay by "
      "about {:.1f} px; the {} seems wrong: --refine-map with --refine-camera of replay or live, "
      "or penumbra map --refine-camera",
      causes.rms_px, causes.pose_px, text_of(suspects_)));
  return notices;
}

void ResidualWatch::add_error(PoseEstimate& pose) const {
  if (error_px_ == 0.0 || pose.tags_used == 0 || !pose.has_pose()) return;
  pose.predicted_overlay_error_px = std::hypot(pose.predicted_overlay_error_px, error_px_);
  if (pose.status != TrackStatus::tracked || pose.predicted_overlay_error_px < kTrackedOverlay_px)
    return;
  pose.status = TrackStatus::uncertain;
  pose.reason = {.cause = PoseCause::systematic_error,
                 .error_px = pose.predicted_overlay_error_px,
                 .suspects = suspects_};
}

std::optional<ResidualCauses> ResidualWatch::found() const {
  const std::lock_guard lock(mutex_);
  return found_;
}

}  // namespace penumbra
