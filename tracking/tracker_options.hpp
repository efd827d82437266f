// Options of the trackers.
#pragma once

#include <optional>
#include <string_view>

#include "core/geometry/pose_estimate.hpp"

namespace penumbra {

// How a frame is measured once a pose is known.
enum class TrackingMode {
  detect,     // detects tags in every frame: the baseline
  fast,       // aligns the tag pattern with a limited number of pixels
  accurate,   // aligns it with every pixel at an edge, except where motion blurs the image
  automatic,  // fast while the view moves, accurate when it rests or shows fewer than three tags
};

// By the names of --tracking, "auto" for automatic; nothing for another word.
[[nodiscard]] constexpr std::optional<TrackingMode> tracking_mode_from_string(
    std::string_view name) {
  if (name == "detect") return TrackingMode::detect;
  if (name == "fast") return TrackingMode::fast;
  if (name == "accurate") return TrackingMode::accurate;
  if (name == "auto") return TrackingMode::automatic;
  return std::nullopt;
}

// When a frame is searched for tags that are not where they were (GroupTracker).
enum class SearchTiming {
  in_frame,  // the frame waits for the search
  // Groups beside a tracked table: the frame after the search uses the result, the same on every
  // machine. The table: in the frame.
  next_frame,
  // The frame that finds the search done uses the result. The table is searched for in the frame
  // too, but at full resolution only where a search beside it has just found its tags.
  when_done,
};

struct TrackerOptions {
  TrackingMode mode = TrackingMode::automatic;
  // Samples pixels until their noise leaves a predicted overlay error below this [px]; 0: as many
  // as the mode allows. `fast` never exceeds its own number.
  double pose_budget_px = 0.0;
  SearchTiming search_timing = SearchTiming::next_frame;
  // next_frame: a second thread searches; the poses are the same. when_done always uses one.
  bool search_thread = false;
  double hold_s = kHoldSeconds;  // how long a pose is extrapolated without a measurement [s]
};

}  // namespace penumbra
