// Pose measured in one frame, by detection or by alignment.
#pragma once

#include <limits>
#include <optional>
#include <vector>

#include "tracking/detection/board_pose.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

struct Measurement {
  RefinedPose best;
  std::optional<RefinedPose> second;  // the other pose of a planar target
  BoardPose by_corners;               // what `best` and `second` are where they are not aligned
  bool by_ceres = false;              // whether Ceres refined that
  double ambiguity_ratio = std::numeric_limits<double>::infinity();
  int tags_used = 0;
  std::vector<int> rejected;  // places in RigidTags::tags
  bool ambiguous = false;     // the second pose may be the true one
  bool contradictory = false;
  bool aligned = false;             // found by an alignment: its covariance holds as it is
  double variance_inflation = 1.0;  // of an alignment; see the function of this name
  // What a map that the tags contradict may do to the overlay [px].
  double map_px = 0.0;
};

}  // namespace penumbra
