// A recording, replayed: every frame in order through the session, to a window and to files.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/output/run_outputs.hpp"
#include "app/recording/frame_range.hpp"
#include "app/recording/recording_source.hpp"
#include "app/replay/comparison.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "app/window/viewer.hpp"
#include "core/error.hpp"
#include "render/frame_plan.hpp"
#include "tracking/table_tracker.hpp"

namespace penumbra {

struct ReplayRequest : OutputRequest {
  std::filesystem::path recording;
  std::filesystem::path scene;
  std::string camera_name;                    // of a camera.yaml with several
  std::optional<std::filesystem::path> tags;  // instead of the recording's
  PlanOptions plan;
  bool rectified = false;   // the picture without the lens's distortion
  std::optional<int> msaa;  // as CompositorOptions'
  std::optional<bool> pixel_buffers;
  bool video_light = true;  // virtual objects are lit as the video is
  // Two or more, side by side in one picture; `plan` is then not used.
  std::vector<ComparedTechnique> compare;
  std::optional<std::filesystem::path> kernel_file;  // for the scene's casters that it fits
  TrackerOptions tracking;
  std::optional<std::string> poses_from;  // "groundtruth" or a TUM file: no tracker
  FrameRange frames;
  // 1: one stage after another; more: frames are decoded, tracked, drawn and encoded side by side,
  // each stage on a thread of its own. The results are the same.
  int threads = 2;
  bool realtime = false;
  bool window = true;  // where there is a display
  ViewerOptions viewer;
  bool smooth = false;     // the pose that is drawn
  PairingOptions pairing;  // with the recording's ground truth
  bool edits = true;       // what was moved and changed while it was recorded happens again
};

// Every path is checked before the first frame. Stopped by Ctrl-C or by closing the window, the
// files hold the frames up to then and the report says so; an error leaves none.
[[nodiscard]] Result<RunReport> run_replay(const ReplayRequest& request);

// A tracker of the recording's tags, or the poses that the request names.
[[nodiscard]] Result<PoseSource> open_replay_poses(const ReplayRequest& request,
                                                   const Recording& recording, const Scene& scene);
// The median time between frames.
[[nodiscard]] double frame_interval_s(const Recording& recording);

}  // namespace penumbra
