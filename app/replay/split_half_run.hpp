// Tracks a recording with disjoint halves of its tags, to measure the accuracy without ground
// truth. See docs/tracking.md#split-halves.
#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "app/run_inputs.hpp"
#include "core/error.hpp"
#include "core/evaluation/split_half.hpp"
#include "core/image/frame.hpp"
#include "tracking/evaluation/residual_causes.hpp"
#include "tracking/tracker_options.hpp"

namespace penumbra {

struct SplitHalfRequest {
  std::filesystem::path recording;
  std::optional<std::filesystem::path> tags, camera;  // instead of the recording's
  std::string camera_name;
  TrackerOptions tracking;
  // Called for each frame and split (from 0), in order. An error ends the run.
  std::function<Result<void>(const Frame&, std::size_t split, const HalfDifference&)> on_compared;
};

struct SplitReport {
  std::array<std::vector<int>, 2> ids;  // tag ids of each half
  std::vector<HalfDifference> frames;   // one for each frame of the recording
  SplitHalfErrors errors;
};

struct SplitHalfReport {
  std::filesystem::path recording;
  TagsInUse tags;
  int frames = 0;
  std::vector<SplitReport> splits;
  SplitHalfErrors pooled;  // over the frames of all splits
  ResidualCauses causes;
  double given_row_s = 0.0;  // row time in the camera file
};

// Fails if no frame shows four tags, or no frame could be compared. Ctrl-C is an error, too.
[[nodiscard]] Result<SplitHalfReport> run_split_half(const SplitHalfRequest& request);

}  // namespace penumbra
