// A frame with its poses, and the times of tracking.
#pragma once

#include <vector>

#include "core/geometry/group_pose.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

// Times of the last frame. A wall time of 0 means that the stage did not run.
struct TrackTimes {
  double total_ms = 0.0, detect_ms = 0.0, align_ms = 0.0, solve_ms = 0.0;  // wall
  // CPU time of the calling thread, and of a background search.
  double total_cpu_ms = 0.0, detect_cpu_ms = 0.0, align_cpu_ms = 0.0, solve_cpu_ms = 0.0;
  // Background search whose tags this frame used. Its CPU time is in the total.
  double search_ms = 0.0, search_cpu_ms = 0.0;
  bool search_used = false;     // whether tags of such a search were used
  bool full_detection = false;  // whether tags were detected in the full frame
  bool pyramid_search = false;  // whether the pyramid search found the pattern
  bool roi_detection = false;   // whether detection in a region of interest was enough
  bool every_pixel = false;     // whether the last alignment could use every pixel at an edge
  int samples = 0;              // pixels that the last alignment used
  // Tags of the map that the last alignment skipped.
  int tags_out_of_view = 0, tags_too_small = 0;
  bool sampling_stopped = false;      // it took fewer pixels because the pose was good enough
  bool fewer_pixels = false;          // its number of pixels was limited because the view moves
  bool near_start = false;            // it began near the pose, so without its wide stage
  bool corner_solve_skipped = false;  // tags were detected, but Ceres did not refine their pose
};

struct TrackedFrame {
  Frame frame;
  PoseEstimate pose;
  TrackTimes times;
  std::vector<GroupEstimate> groups;  // beside the table, in the order of the tag map
  int groups_skipped = 0;             // not tracked, because nothing asks where they are
};

}  // namespace penumbra
