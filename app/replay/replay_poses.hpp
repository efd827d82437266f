// Source of poses for a replay: a tracker, the ground truth or a file.
#pragma once

#include "app/recording/recording_source.hpp"
#include "app/replay/replay_run.hpp"
#include "app/session/session.hpp"
#include "core/error.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// Opens a tracker of the recording's tags, or the poses that the request selects.
[[nodiscard]] Result<PoseSource> open_replay_poses(const ReplayRequest& request,
                                                   const Recording& recording, const Scene& scene);

// Warns if the timestamps of frames and ground truth are in different units of time.
void check_groundtruth(const ReplayRequest& request, const Recording& recording);
// Compares the run's poses with the recording's ground truth and adds the errors to the report.
void add_accuracy(const ReplayRequest& request, const Recording& recording, const RunRecorder& run,
                  RunReport& report);

}  // namespace penumbra
