#include "app/session/map_refinement.hpp"

#include <chrono>
#include <utility>

#include "app/logging.hpp"

namespace penumbra {

MapRefinement::MapRefinement(const CameraModel& camera, const TagMap& given,
                             RefinementTiming timing)
    : camera_(camera), given_(given), timing_(timing), keyframes_(camera, given), current_(given) {
  if (camera.parameters().rolling_shutter_row_s.value_or(0.0) > 0.0) {
    log_warning(
        "--refine-map measures tags as if all rows were exposed at once; move the camera slowly, "
        "or use penumbra map, which corrects the row time");
  }
}

std::optional<TagMap> MapRefinement::observe(const TrackedFrame& tracked) {
  const TrackStatus status = tracked.pose.status;
  if (status == TrackStatus::tracked || status == TrackStatus::uncertain) {
    due_ = keyframes_.add(luma(tracked.frame, scratch_), tracked.pose.T_table_camera) || due_;
    const std::lock_guard lock(mutex_);
    report_.keyframes = keyframes_.added();
  }
  if (due_ && !running_.valid() && !stop_.stop_requested()) begin();
  return take();
}

void MapRefinement::begin() {
  due_ = false;
  running_ = std::async(
      std::launch::async,
      [camera = camera_, maps = MapsToRefine{given_, map()}, keyframes = keyframes_.kept(),
       stop = stop_.get_token()] { return refine_map(camera, maps, keyframes, stop); });
}

std::optional<TagMap> MapRefinement::take() {
  if (!running_.valid()) return std::nullopt;
  if (timing_ == RefinementTiming::when_done &&
      running_.wait_for(std::chrono::seconds(0)) != std::future_status::ready)
    return std::nullopt;
  Result<TagMap> refined = running_.get();
  if (!refined) {
    log_debug("the tag map is not replaced: {}", refined.error().message);
    return std::nullopt;
  }
  const std::lock_guard lock(mutex_);
  current_ = *refined;
  ++report_.refinements;
  report_.change = change_of_map(given_, current_);
  log_info("tag map refined from {} keyframes: its corners moved by {:.2f} mm (RMS)",
           report_.keyframes, report_.change.rms_m * 1e3);
  return std::move(*refined);
}

TagMap MapRefinement::map() const {
  const std::lock_guard lock(mutex_);
  return current_;
}

MapRefinementReport MapRefinement::report() const {
  const std::lock_guard lock(mutex_);
  return report_;
}

}  // namespace penumbra
