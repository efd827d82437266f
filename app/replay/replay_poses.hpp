// Source of poses for a replay: a tracker, the ground truth or a file.
#pragma once

#include "app/recording/recording_source.hpp"
#include "app/replay/replay_run.hpp"
#include "app/session/session.hpp"
#include "core/error.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// A tracker of the recording's tags, or the poses that the request names.
[[nodiscard]] Result<PoseSource> open_replay_poses(const ReplayRequest& request,
                                                   const Recording& recording, const Scene& scene);

// Warns if the clock or unit of the ground truth can't be the recording's.
void check_groundtruth(const ReplayRequest& request, const Recording& recording);
// Adds the errors of the poses against the recording's ground truth to the report.
void add_accuracy(const ReplayRequest& request, const Recording& recording, const RunRecorder& run,
                  RunReport& report);

}  // namespace penumbra
