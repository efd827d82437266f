// Writes what a session refined while it tracked.
#pragma once

#include <optional>

#include "app/output/run_outputs.hpp"
#include "app/session/map_refinement.hpp"
#include "core/camera/camera_file.hpp"
#include "core/error.hpp"

namespace penumbra {

// Writes the requested files at the end of a run: the map, and the camera with its lens.
[[nodiscard]] inline Result<void> write_refined(MapRefinement& refinement, RunOutputs& outputs,
                                                const std::optional<CalibrationRecord>& given) {
  const RefinedFiles files =
      outputs.refined_camera ? refinement.files_with_lens(given) : refinement.files(given);
  return outputs.write_refined(files.map, files.camera, files.record ? &*files.record : nullptr);
}

}  // namespace penumbra
