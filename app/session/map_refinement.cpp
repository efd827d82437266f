#include "app/session/map_refinement.hpp"

#include <chrono>
#include <utility>

#include "app/logging.hpp"
#include "calib/refinement/refined_record.hpp"

namespace penumbra {
namespace {

// Maximum sigma of a row time relative to it, and the number of measured frames from which on it is
// used in any case.
constexpr double kMaxRowTimeSigma = 0.1;
constexpr int kSufficientFrames = 32;

}  // namespace

MapRefinement::MapRefinement(const CameraModel& camera, const TagMap& given,
                             RefinementTiming timing)
    : given_(given), timing_(timing), keyframes_(camera, given), camera_(camera), current_(given) {}

std::optional<RefinedModel> MapRefinement::observe(const TrackedFrame& tracked,
                                                   const std::optional<ResidualCauses>& causes) {
  const TrackStatus status = tracked.pose.status;
  if (status == TrackStatus::tracked || status == TrackStatus::uncertain) {
    due_ = keyframes_.add(luma(tracked.frame, scratch_), tracked.frame.timestamp_ns,
                          tracked.pose.T_table_camera) ||
           due_;
    const std::lock_guard lock(mutex_);
    report_.keyframes = keyframes_.added();
    kept_ = keyframes_.kept();
  }
  // Tests each result of the watch once.
  const int tested = std::exchange(tested_frames_, causes ? causes->frames : 0);
  bool changed = causes && causes->frames != tested && use_row_time(*causes);
  if (due_ && !running_.valid() && !stop_.stop_requested()) begin();
  changed = take() || changed;
  if (!changed) return std::nullopt;
  const std::lock_guard lock(mutex_);
  return RefinedModel{camera_, current_};
}

// Returns true if the causes of the residuals show a new row time.
bool MapRefinement::use_row_time(const ResidualCauses& causes) {
  const std::lock_guard lock(mutex_);
  const std::optional<RowTime> found = row_time_of(camera_, causes);
  const bool is_accurate = found && (found->sigma_s < kMaxRowTimeSigma * found->seconds ||
                                     causes.frames >= kSufficientFrames);
  if (!is_accurate) return false;
  auto camera = with_row_time(camera_, found->seconds);
  if (!camera) return false;
  camera_ = std::move(*camera);
  report_.row_time = found;
  log_info("row time {:.2f} +- {:.2f} us: used from the next frame on", found->seconds * 1e6,
           found->sigma_s * 1e6);
  outdated_ = running_.valid();
  // The keyframes so far were surveyed with the previous row time.
  due_ = due_ || keyframes_.kept().size() >= MapKeyframes::kRefinementInterval;
  return true;
}

void MapRefinement::begin() {
  due_ = false;
  const std::lock_guard lock(mutex_);
  running_ =
      std::async(std::launch::async,
                 [camera = camera_, maps = MapsToRefine{given_, current_}, keyframes = kept_,
                  stop = stop_.get_token()] { return refine_map(camera, maps, keyframes, stop); });
}

// Returns true if a refinement gave a new map.
bool MapRefinement::take() {
  if (!running_.valid()) return false;
  if (timing_ == RefinementTiming::when_done &&
      running_.wait_for(std::chrono::seconds(0)) != std::future_status::ready)
    return false;
  Result<TagMap> refined = running_.get();
  if (std::exchange(outdated_, false)) return false;
  if (!refined) {
    log_debug("the tag map is not replaced: {}", refined.error().message);
    return false;
  }
  const std::lock_guard lock(mutex_);
  current_ = std::move(*refined);
  ++report_.refinements;
  report_.change = change_of_map(given_, current_);
  log_info("tag map refined from {} keyframes: its corners moved by {:.2f} mm (RMS)",
           report_.keyframes, report_.change.rms_m * 1e3);
  return true;
}

MapRefinementReport MapRefinement::report() const {
  const std::lock_guard lock(mutex_);
  return report_;
}

RefinedFiles MapRefinement::files(const std::optional<CalibrationRecord>& given) const {
  const std::lock_guard lock(mutex_);
  RefinedFiles files{current_, camera_, given};
  if (!report_.row_time) return files;
  if (!files.record) files.record.emplace();
  files.record->row_time_sigma_s = report_.row_time->sigma_s;
  return files;
}

RefinedFiles MapRefinement::files_with_lens(const std::optional<CalibrationRecord>& given) {
  RefinedFiles files = this->files(given);
  KeyframeList keyframes;
  std::optional<RowTime> row_time;
  {
    const std::lock_guard lock(mutex_);
    keyframes = kept_;
    row_time = report_.row_time;
  }
  auto refined = refine_lens(files.camera, {given_, files.map}, keyframes,
                             given ? given->standard_deviations : std::vector<double>(), {});
  const std::lock_guard lock(mutex_);
  if (!refined) {
    report_.lens_kept = refined.error().message;
    return files;
  }
  const TagSurvey& survey = refined->survey;
  report_.lens_gain = survey.lens_gain;
  report_.change = change_of_map(given_, refined->map);
  return {std::move(refined->map), survey.camera,
          refined_record(survey, row_time, given,
                         fmt::format("{} tags, tracked by penumbra", survey.tags.size()))};
}

}  // namespace penumbra
