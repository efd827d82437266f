// Refines the tag map and the row time of a session while it tracks (--refine-map), and the lens at
// its end (--refine-camera). See docs/tracking.md#refining-the-map.
#pragma once

#include <cstdint>
#include <future>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "calib/refinement/keyframes.hpp"
#include "calib/refinement/map_refiner.hpp"
#include "calib/survey/row_time.hpp"
#include "core/camera/camera_file.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "tracking/evaluation/residual_causes.hpp"
#include "tracking/tracked_frame.hpp"

namespace penumbra {

// When a refinement is used.
enum class RefinementTiming {
  in_frame,   // the frame of the last keyframe waits for it: results do not depend on the machine
  when_done,  // it runs in a thread; the first frame after its end uses it
};

struct MapRefinementReport {
  int keyframes = 0;                // chosen since the start
  int refinements = 0;              // maps that replaced the previous one
  MapChange change;                 // from the given map to the latest one
  std::optional<RowTime> row_time;  // set if one was estimated
  // With --refine-camera: how much the lens improved (TagSurvey::lens_gain), or why it is kept.
  std::optional<double> lens_gain;
  std::string lens_kept;
};

// Camera and map for the next frames.
struct RefinedModel {
  CameraModel camera;  // the given lens, with an estimated row time
  TagMap map;
};

// Content of the files that a session writes at its end.
struct RefinedFiles {
  TagMap map;
  CameraModel camera;
  std::optional<CalibrationRecord> record;
};

class MapRefinement {
 public:
  MapRefinement(const CameraModel& camera, const TagMap& given, RefinementTiming timing);
  MapRefinement(const MapRefinement&) = delete;
  MapRefinement& operator=(const MapRefinement&) = delete;
  ~MapRefinement() { stop(); }

  // Call this for every tracked frame in order, on one thread. `causes`: ResidualWatch::latest().
  // Returns what the next frames are to be tracked with, if that changed.
  [[nodiscard]] std::optional<RefinedModel> observe(const TrackedFrame& tracked,
                                                    const std::optional<ResidualCauses>& causes);
  // Ends a running refinement soon; no further one begins. Any thread may call this.
  void stop() { stop_.request_stop(); }

  // Any thread may call these.
  [[nodiscard]] MapRefinementReport report() const;
  // The latest map and row time. `given`: record of the given camera file.
  [[nodiscard]] RefinedFiles files(const std::optional<CalibrationRecord>& given) const;
  // Solves for the lens too, which takes seconds; if the keyframes do not show a better one, the
  // same as files(). `lens_sigmas` of `given` are the prior.
  [[nodiscard]] RefinedFiles files_with_lens(const std::optional<CalibrationRecord>& given);

 private:
  [[nodiscard]] bool use_row_time(const ResidualCauses& causes);
  void begin();
  [[nodiscard]] bool take();

  TagMap given_;
  RefinementTiming timing_;
  MapKeyframes keyframes_;
  std::vector<std::uint8_t> scratch_;
  bool due_ = false;
  int tested_frames_ = 0;  // ResidualCauses::frames of the latest result of the watch
  bool outdated_ = false;  // the running refinement began with another row time
  std::stop_source stop_;
  mutable std::mutex mutex_;  // guards the following
  CameraModel camera_;
  TagMap current_;
  KeyframeList kept_;
  MapRefinementReport report_;
  std::future<Result<TagMap>> running_;
};

}  // namespace penumbra
