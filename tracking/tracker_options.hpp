// Options of the trackers.
#pragma once

#include "core/geometry/pose_estimate.hpp"
#include "core/text/enum_names.hpp"

namespace penumbra {

// How a frame is measured once a pose is known.
enum class TrackingMode {
  detect,     // detects tags in every frame (baseline)
  fast,       // aligns the tag pattern with a limited number of pixels
  accurate,   // aligns the tag pattern with every pixel at an edge, unless motion blurs the image
  automatic,  // fast while the view moves; accurate if it rests or has fewer than three tags
};

// Values of --tracking, in the order of the help.
inline constexpr auto kTrackingModeNames =
    std::to_array<EnumName<TrackingMode>>({{TrackingMode::fast, "fast"},
                                           {TrackingMode::accurate, "accurate"},
                                           {TrackingMode::automatic, "auto"},
                                           {TrackingMode::detect, "detect"}});

// When GroupTracker searches a frame for tags that it has lost.
enum class SearchTiming {
  in_frame,  // the frame waits for the search
  // The next frame waits for the search, so that results do not depend on the machine. Tags of a
  // lost table are searched for in_frame.
  next_frame,
  // The first frame after the search ended uses the result. Tags of a lost table are also searched
  // for in the frame, but at full resolution only after a background search found them.
  when_done,
};

struct TrackerOptions {
  TrackingMode mode = TrackingMode::automatic;
  // Samples pixels until the predicted overlay error is below this [px], within the limit of the
  // mode; 0: no budget, only the limit of the mode.
  double pose_budget_px = 0.0;
  SearchTiming search_timing = SearchTiming::next_frame;
  // next_frame: searches in a second thread, with the same poses. when_done always uses one.
  bool search_thread = false;
  double hold_s = kHoldSeconds;  // maximum time to extrapolate a pose without a measurement [s]
};

}  // namespace penumbra
