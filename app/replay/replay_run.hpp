// Replays a recording: processes every frame in order and writes to a window and to files.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/recording/recording_source.hpp"
#include "app/report/run_report.hpp"
#include "app/run/run_request.hpp"
#include "core/error.hpp"
#include "core/evaluation/pairing.hpp"
#include "render/frame_plan.hpp"

namespace penumbra {

inline constexpr std::size_t kMinPanes = 2;
inline constexpr std::size_t kMaxPanes = 8;

struct ComparedTechnique {
  std::string name;  // caption, and key in the report
  PlanOptions plan;
};

// `threads`: with more than 1, decoding, tracking, drawing and encoding run in parallel.
struct ReplayRequest : RunRequest {
  std::filesystem::path recording;
  std::optional<std::filesystem::path> camera;  // replaces the recording's camera.yaml
  std::string camera_name;                      // selects one camera of a file with several
  std::optional<std::filesystem::path> tags;    // replaces the recording's tags.yaml
  // Techniques to draw side by side in one image, at least two; `plan` is then ignored.
  std::vector<ComparedTechnique> compare;
  std::optional<std::string> poses_from;  // "groundtruth" or a TUM file; replaces the tracker
  FrameRange frames;
  bool realtime = false;
  PairingOptions pairing;  // how poses are paired with the recording's ground truth
  bool edits = true;       // repeats the edits of the recorded session
};

// Checks all paths before the first frame. If Ctrl-C or the window ends the replay, the files
// contain the frames up to then and the report is marked as interrupted. An error leaves no files.
[[nodiscard]] Result<RunReport> run_replay(const ReplayRequest& request);

}  // namespace penumbra
