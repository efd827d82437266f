// Draws a replay: one session, or several side by side.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "app/replay/comparison.hpp"
#include "app/replay/replay_run.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "app/session/session_host.hpp"
#include "core/error.hpp"

namespace penumbra {

class ReplayView {
 public:
  [[nodiscard]] static Result<ReplayView> open(const ReplayRequest& request, GlContext& context,
                                               const std::shared_ptr<const Scene>& scene,
                                               const CameraModel& camera, PoseSource poses,
                                               const SessionOptions& options);

  [[nodiscard]] TrackedFrame track(const Frame& frame) {
    return comparison_ ? comparison_->track(frame) : session_->track(frame);
  }
  [[nodiscard]] Result<SessionFrame> draw(TrackedFrame tracked, bool read_back);
  // The image that draw() read back: the last one, or the one before it (SessionFrame::picture).
  [[nodiscard]] std::span<const std::uint8_t> pixels() const {
    return comparison_ ? comparison_->grid().rgba() : std::span<const std::uint8_t>(pixels_);
  }
  bool replay_edit(const SceneEdit& edit) {
    return comparison_ ? comparison_->replay_edit(edit) : session_->replay_edit(edit);
  }
  // Null in a comparison, whose images are complete as soon as they are drawn.
  [[nodiscard]] Session* session() { return session_.get(); }
  void take_gpu_times(RunRecorder& run);
  // The session that draws, or the first one of a comparison.
  [[nodiscard]] const Session& first_session() const {
    return comparison_ ? comparison_->session() : *session_;
  }
  [[nodiscard]] std::vector<PaneReport> pane_reports() const {
    return comparison_ ? comparison_->reports() : std::vector<PaneReport>();
  }

  // Returns the host for a window, which the view owns.
  [[nodiscard]] Result<RunHost*> open_host(GlContext& context, RunRecorder& run,
                                           const Recording& recording);

 private:
  ReplayView() = default;
  std::unique_ptr<Session> session_;
  std::unique_ptr<Comparison> comparison_;
  std::vector<std::uint8_t> pixels_;
  std::unique_ptr<RunHost> host_;
};

// Size of the image that a replay draws.
[[nodiscard]] GlContext::Size image_size(const ReplayRequest& request, const CameraModel& camera);

}  // namespace penumbra
