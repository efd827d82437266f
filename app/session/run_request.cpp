#include "app/session/run_request.hpp"

namespace penumbra {

SessionOptions session_options(const RunRequest& request) {
  SessionOptions options;
  options.plan = request.plan;
  options.rectified = request.rectified;
  options.video_light = request.video_light;
  options.msaa = request.msaa;
  options.pixel_buffers = request.pixel_buffers;
  options.smooth = request.smooth;
  return options;
}

void describe_run(const RunRequest& request, const GlContext& context, const DrawingSetup& drawing,
                  RunReport& report) {
  report.scene = request.scene.string();
  report.threads = request.threads;
  report.msaa_samples = drawing.samples;
  report.pixel_buffers = drawing.pixel_buffers;
  report.gl_renderer = context.info().renderer;
  report.gl_version = context.info().version;
}

}  // namespace penumbra
