// The request that live, replay and demo share: tracking, drawing, window and outputs.
#pragma once

#include <filesystem>
#include <optional>

#include "app/output/run_outputs.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "app/window/viewer.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/context.hpp"
#include "tracking/tracker_options.hpp"

namespace penumbra {

struct RunRequest : OutputRequest {
  std::filesystem::path scene;
  std::optional<std::filesystem::path> kernel_file;  // for casters with as many vertices
  PlanOptions plan;
  bool rectified = false;   // images without lens distortion
  std::optional<int> msaa;  // as in CompositorOptions
  std::optional<bool> pixel_buffers;
  bool video_light = true;  // virtual objects are lit as the video is
  TrackerOptions tracking;
  bool smooth = false;  // the drawn pose
  bool window = true;   // if there is a display
  ViewerOptions viewer;
  // 1: one stage after another; more: stages run side by side, with the same results.
  int threads = 2;
};

[[nodiscard]] SessionOptions session_options(const RunRequest& request);

// Fills the fields of a report that describe the request and how the session drew.
struct DrawingSetup {
  int samples = 0;
  bool pixel_buffers = false;
};
void describe_run(const RunRequest& request, const GlContext& context, const DrawingSetup& drawing,
                  RunReport& report);

}  // namespace penumbra
