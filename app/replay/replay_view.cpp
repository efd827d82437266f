#include "app/replay/replay_view.hpp"

#include <utility>

#include "core/propagate.hpp"
#include "render/gl/framebuffer.hpp"

namespace penumbra {

Result<ReplayView> ReplayView::open(const ReplayRequest& request, GlContext& context,
                                    const std::shared_ptr<const Scene>& scene,
                                    const CameraModel& camera, PoseSource poses,
                                    const SessionOptions& options) {
  ReplayView view;
  if (request.compare.empty()) {
    PENUMBRA_TRY(auto session, Session::create(context, scene, camera, std::move(poses), options));
    view.session_ = std::make_unique<Session>(std::move(session));
  } else {
    PENUMBRA_TRY(auto comparison, Comparison::create(context, scene, camera, std::move(poses),
                                                     request.compare, options));
    view.comparison_ = std::make_unique<Comparison>(std::move(comparison));
  }
  return view;
}

Result<SessionFrame> ReplayView::draw(TrackedFrame tracked, bool read_back) {
  if (comparison_) return comparison_->draw(tracked);
  if (!read_back) {
    pixels_.clear();
  } else if (pixels_.empty()) {
    const CameraModel& camera = session_->camera();
    pixels_.resize(std::size_t{4} * static_cast<std::size_t>(camera.width()) *
                   static_cast<std::size_t>(camera.height()));
  }
  return session_->draw(std::move(tracked), pixels_, ReadBackTime::later);
}

void ReplayView::take_gpu_times(RunRecorder& run) {
  if (comparison_) {
    comparison_->take_gpu_times();
  } else {
    run.add_gpu_times(session_->take_gpu_times());
  }
}

Result<RunHost*> ReplayView::open_host(GlContext& context, RunRecorder& run,
                                       const Recording& recording) {
  const int frame_count = static_cast<int>(recording.frames.size());
  if (comparison_) {
    const PaneGrid& grid = comparison_->grid();
    PENUMBRA_TRY(auto image, UploadedImage::create(grid.width(), grid.height()));
    host_ =
        std::make_unique<ComparisonHost>(*comparison_, context, std::move(image), run, frame_count);
  } else {
    auto host = std::make_unique<SessionHost>(*session_, run, frame_count);
    host->set_sheet(sheet_area(recording.tags ? &*recording.tags : nullptr));
    host_ = std::move(host);
  }
  host_->set_played_recording(recording.folder);
  return host_.get();
}

GlContext::Size image_size(const ReplayRequest& request, const CameraModel& camera) {
  if (request.compare.empty()) return {camera.width(), camera.height()};
  const GridSize size =
      grid_size(camera.width(), camera.height(), static_cast<int>(request.compare.size()));
  return {size.width, size.height};
}

}  // namespace penumbra
