#include "app/picture_watch.hpp"

#include <utility>

#include "app/logging.hpp"

namespace penumbra {

PictureWatch::PictureWatch(const TagMap& tags) {
  if (auto check = PictureCheck::create(tags)) check_.emplace(std::move(*check));
}

void PictureWatch::saw(const TrackedFrame& tracked) {
  if (!check_) return;
  const PoseEstimate& pose = tracked.pose;
  if (pose.status != TrackStatus::lost || pose.tags_used > 0) {
    check_.reset();
    return;
  }
  const auto fault = check_->nothing_found(luma(tracked.frame, scratch_));
  if (!fault) return;
  check_.reset();
  log_warning("{}; nothing is tracked in such pictures", advice(*fault));
  const std::lock_guard lock(mutex_);
  fault_ = fault;
}

std::optional<PictureFault> PictureWatch::fault() const {
  const std::lock_guard lock(mutex_);
  return fault_;
}

}  // namespace penumbra
