// A frame with its poses, and the times of tracking.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "core/geometry/group_pose.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "core/image/frame.hpp"
#include "core/text/enum_names.hpp"

namespace penumbra {

// Work that was skipped in a frame, and its key in the report.
enum class SkippedWork : std::size_t {
  out_of_view,    // tags outside the image or facing away
  too_small,      // tags
  within_budget,  // the alignment met the error budget before using all pixels
  while_moving,   // the alignment used fewer pixels because the view moves
  wide_stage,     // the alignment started near the pose
  corner_solve,   // tags were detected, but Ceres did not refine their pose
};
inline constexpr auto kSkippedWorkNames =
    std::to_array<EnumName<SkippedWork>>({{SkippedWork::out_of_view, "tag_out_of_view"},
                                          {SkippedWork::too_small, "tag_too_small"},
                                          {SkippedWork::within_budget, "pixels_within_budget"},
                                          {SkippedWork::while_moving, "pixels_while_moving"},
                                          {SkippedWork::wide_stage, "wide_stage"},
                                          {SkippedWork::corner_solve, "corner_solve"}});

// Number of skipped tags or alignments of each SkippedWork.
class SkippedWorkCounts {
 public:
  [[nodiscard]] int& operator[](SkippedWork work) {
    return counts_[static_cast<std::size_t>(work)];
  }
  [[nodiscard]] int operator[](SkippedWork work) const {
    return counts_[static_cast<std::size_t>(work)];
  }

 private:
  std::array<int, kSkippedWorkNames.size()> counts_{};
};

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
  SkippedWorkCounts skipped;    // by the final alignment and the corner pose
};

struct TrackedFrame {
  Frame frame;
  PoseEstimate pose;
  TrackTimes times;
  std::vector<GroupEstimate> groups;  // groups other than the table, in the order of the tag map
  int groups_skipped = 0;             // groups that are not tracked because no caller needs them
};

}  // namespace penumbra
