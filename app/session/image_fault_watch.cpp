#include "app/session/image_fault_watch.hpp"

#include <utility>

#include "app/logging.hpp"

namespace penumbra {

void ImageFaultWatch::observe(const TrackedFrame& tracked) {
  if (!tags_) return;
  const PoseEstimate& pose = tracked.pose;
  if (pose.status != TrackStatus::lost || pose.tags_used > 0) {
    check_.reset();
    seen_ = true;
    lost_ = 0;
    return;
  }
  ++lost_;
  if (seen_ && lost_ < kLongLoss) return;
  if (!check_) {
    auto check = ImageCheck::create(*tags_);
    if (!check) {
      log_warning("images are not checked for mirrored or negative tags: {}",
                  check.error().message);
      end();
      return;
    }
    check_.emplace(std::move(*check));
  }
  const auto fault = check_->check_untagged(luma(tracked.frame, scratch_));
  if (!fault) return;
  end();
  log_warning("{}; nothing is tracked in such images", advice(*fault));
  const std::lock_guard lock(mutex_);
  fault_ = fault;
}

void ImageFaultWatch::end() {
  check_.reset();
  tags_.reset();
}

std::optional<ImageFault> ImageFaultWatch::fault() const {
  const std::lock_guard lock(mutex_);
  return fault_;
}

}  // namespace penumbra
