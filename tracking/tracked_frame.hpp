// A frame with its poses, and the times of tracking.
#pragma once

#include <vector>

#include "core/geometry/group_pose.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

// Times of one frame. A wall time of 0 means that the stage did not run.
struct TrackTimes {
  double total_ms = 0.0, detect_ms = 0.0, align_ms = 0.0, solve_ms = 0.0;  // wall
  // CPU times of the calling thread.
  double total_cpu_ms = 0.0, detect_cpu_ms = 0.0, align_cpu_ms = 0.0, solve_cpu_ms = 0.0;
  // Times of the background search whose tags this frame used. total_cpu_ms includes search_cpu_ms.
  double search_ms = 0.0, search_cpu_ms = 0.0;
  bool search_used = false;     // tags of a background search were used
  bool full_detection = false;  // tags were detected in the full frame
  bool pyramid_search = false;  // the pyramid search found the pattern
  bool roi_detection = false;   // detection in a region of interest was sufficient
  bool every_pixel = false;     // the final alignment was allowed to use every pixel at an edge
  int samples = 0;              // pixels that the final alignment used
  // Tags of the map that the final alignment skipped.
  int tags_out_of_view = 0, tags_too_small = 0;
  bool sampling_stopped = false;      // the alignment met the error budget before using all pixels
  bool fewer_pixels = false;          // the alignment used fewer pixels because the view moves
  bool near_start = false;            // the alignment started near the pose, without the wide stage
  bool corner_solve_skipped = false;  // tags were detected, but Ceres did not refine their pose
};

struct TrackedFrame {
  Frame frame;
  PoseEstimate pose;
  TrackTimes times;
  std::vector<GroupEstimate> groups;  // groups other than the table, in the order of the tag map
  int groups_skipped = 0;             // groups that are not tracked because no caller needs them
};

}  // namespace penumbra
