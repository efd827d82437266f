// Refines the tag map of a session while it tracks (--refine-map).
#pragma once

#include <cstdint>
#include <future>
#include <mutex>
#include <optional>
#include <stop_token>
#include <vector>

#include "calib/survey/keyframes.hpp"
#include "calib/survey/map_refiner.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "tracking/tracked_frame.hpp"

namespace penumbra {

// When a refinement is used.
enum class RefinementTiming {
  in_frame,   // the frame of the last keyframe waits for it: results do not depend on the machine
  when_done,  // it runs in a thread; the first frame after its end uses it
};

struct MapRefinementReport {
  int keyframes = 0;    // chosen since the start
  int refinements = 0;  // maps that replaced the previous one
  MapChange change;     // from the given map to the latest one
};

class MapRefinement {
 public:
  MapRefinement(const CameraModel& camera, const TagMap& given, RefinementTiming timing);
  MapRefinement(const MapRefinement&) = delete;
  MapRefinement& operator=(const MapRefinement&) = delete;
  ~MapRefinement() { stop(); }

  // Call this for every tracked frame in order, on one thread. Returns a refined map to track the
  // next frames with, if there is a new one.
  [[nodiscard]] std::optional<TagMap> observe(const TrackedFrame& tracked);
  // Ends a running refinement soon; no further one begins. Any thread may call this.
  void stop() { stop_.request_stop(); }

  // The latest map and the numbers about it; any thread may call these.
  [[nodiscard]] TagMap map() const;
  [[nodiscard]] MapRefinementReport report() const;

 private:
  void begin();
  [[nodiscard]] std::optional<TagMap> take();

  CameraModel camera_;
  TagMap given_;
  RefinementTiming timing_;
  MapKeyframes keyframes_;
  std::vector<std::uint8_t> scratch_;
  bool due_ = false;
  std::stop_source stop_;
  mutable std::mutex mutex_;
  TagMap current_;              // guarded by mutex_
  MapRefinementReport report_;  // guarded by mutex_
  std::future<Result<TagMap>> running_;
};

}  // namespace penumbra
