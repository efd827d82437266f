// Replays a recording: every frame in order through the session, to a window and to files.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/recording/recording_source.hpp"
#include "app/report/run_report.hpp"
#include "app/session/run_request.hpp"
#include "core/error.hpp"
#include "core/evaluation/pairing.hpp"
#include "render/frame_plan.hpp"

namespace penumbra {

inline constexpr std::size_t kLeastPanes = 2;
inline constexpr std::size_t kMostPanes = 8;

struct ComparedTechnique {
  std::string name;  // the caption, and the key in the report
  PlanOptions plan;
};

// threads: with more than 1, frames are decoded, tracked, drawn and encoded side by side.
struct ReplayRequest : RunRequest {
  std::filesystem::path recording;
  std::string camera_name;                    // in a camera.yaml with several cameras
  std::optional<std::filesystem::path> tags;  // instead of the recording's
  // Two or more techniques side by side in one image; `plan` is then not used.
  std::vector<ComparedTechnique> compare;
  std::optional<std::string> poses_from;  // "groundtruth" or a TUM file: no tracker
  FrameRange frames;
  bool realtime = false;
  PairingOptions pairing;  // with the recording's ground truth
  bool edits = true;       // edits of the recorded session are repeated
};

// Checks every path before the first frame. If Ctrl-C or the window ends it, the files hold the
// frames up to then and the report says so; an error leaves no files.
[[nodiscard]] Result<RunReport> run_replay(const ReplayRequest& request);

}  // namespace penumbra
