// Request fields that live, replay, demo and study share, and those that all but study share.
#pragma once

#include <filesystem>
#include <optional>
#include <vector>

#include "app/output/run_outputs.hpp"
#include "app/report/run_report.hpp"
#include "app/session/placed_object.hpp"
#include "app/session/session.hpp"
#include "app/window/viewer.hpp"
#include "render/gl/context.hpp"
#include "tracking/tracker_options.hpp"

namespace penumbra {

struct SessionRequest {
  TrackerOptions tracking;
  bool window = true;  // opens a window if there is a display
};

// Drawing, window and outputs of live, replay and demo.
struct RunRequest : SessionRequest, OutputRequest, SessionOptions {
  RunRequest() { video_light = true; }
  std::filesystem::path scene;
  std::vector<ObjectRequest> objects;  // added to the scene
  // Kernels for the casters with the file's number of vertices.
  std::optional<std::filesystem::path> kernel_file;
  bool refine_map = false;  // refines tag map and row time while tracking (MapRefinement)
  ViewerOptions viewer;
  // 1: stages run one after another; more: stages run in parallel, with the same results.
  int threads = 2;
};

// Fills the fields of a report that describe the request and how the session draws.
inline void describe_run(const RunRequest& request, const GlContext& context,
                         const Session& session, RunReport& report) {
  report.scene = request.scene.string();
  if (request.refined_map) report.refined_map = request.refined_map->string();
  if (request.refined_camera) report.refined_camera = request.refined_camera->string();
  report.threads = request.threads;
  report.msaa_samples = session.samples();
  report.pixel_buffers = session.pixel_buffers();
  report.gl_renderer = context.info().renderer;
  report.gl_version = context.info().version;
}

}  // namespace penumbra
