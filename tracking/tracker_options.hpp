// Options of the trackers.
#pragma once

#include "core/geometry/pose_estimate.hpp"
#include "tracking/detection/tag_detector.hpp"
#include "tracking/tracking_mode.hpp"

namespace penumbra {

// When a frame is searched for tags that are not where they were (GroupTracker).
enum class SearchTiming {
  in_frame,  // before the frame is done: it waits for the search
  // Groups beside a tracked table: the frame after the search uses what it found, the same on every
  // machine. The table: in the frame.
  next_frame,
  // The frame that finds the search done uses what it found. The table is searched for in the frame
  // too, but at full resolution only where a search beside it has just seen its tags.
  when_done,
};

struct TrackerOptions {
  TrackingMode mode = TrackingMode::automatic;
  TagDetectorOptions detector;
  // Pixels are sampled until their noise leaves a predicted overlay error below this [px]; 0: as
  // many as the mode takes. `fast` never takes more than its own number.
  double pose_budget_px = 0.0;
  SearchTiming search_timing = SearchTiming::next_frame;
  // next_frame: a second thread searches; poses are the same without it. when_done always uses one.
  bool search_thread = false;
  double hold_s = kHoldSeconds;  // how long a pose is extrapolated without a measurement [s]
};

}  // namespace penumbra
