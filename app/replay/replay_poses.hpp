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

// Warns if the ground truth has times or positions that imply another clock or unit.
void check_groundtruth(const ReplayRequest& request, const Recording& recording);
// Adds the errors of the poses against the recording's ground truth to the report.
void add_accuracy(const ReplayRequest& request, const Recording& recording, const RunRecorder& run,
                  RunReport& report);

}  // namespace penumbra
