// Draws a replay: one session, or several side by side.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "app/replay/comparison.hpp"
#include "app/replay/replay_run.hpp"
#include "app/report/run_report.hpp"
#include "app/run/session_host.hpp"
#include "app/session/session.hpp"
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
  // See Session::set_map().
  [[nodiscard]] Result<void> set_map(const CameraModel& camera, const TagMap& tags) {
    return comparison_ ? comparison_->set_map(camera, tags) : session_->set_map(camera, tags);
  }
  void set_map_sigma(double sigma_m) {
    if (comparison_) {
      comparison_->set_map_sigma(sigma_m);
    } else {
      session_->set_map_sigma(sigma_m);
    }
  }
  [[nodiscard]] Result<SessionFrame> draw(TrackedFrame tracked, bool read_back);
  // The image that draw() read back: the latest or the previous one (see ReadBackTime).
  [[nodiscard]] std::span<const std::uint8_t> pixels() const {
    return comparison_ ? comparison_->grid().rgba() : std::span<const std::uint8_t>(pixels_);
  }
  bool replay_edit(const SceneEdit& edit) {
    return comparison_ ? comparison_->replay_edit(edit) : session_->replay_edit(edit);
  }
  // Returns nullptr for a comparison, whose images are never read back late.
  [[nodiscard]] Session* session() { return session_.get(); }
  void take_gpu_times(RunRecorder& run);
  // Returns the only session, or the first one of a comparison.
  [[nodiscard]] const Session& first_session() const {
    return comparison_ ? comparison_->session() : *session_;
  }
  [[nodiscard]] std::vector<PaneReport> pane_reports() const {
    return comparison_ ? comparison_->reports() : std::vector<PaneReport>();
  }

  // Creates the host for a window; the view owns it.
  [[nodiscard]] Result<RunHost*> open_host(GlContext& context, RunRecorder& run,
                                           const Recording& recording);

 private:
  ReplayView() = default;
  std::unique_ptr<Session> session_;
  std::unique_ptr<Comparison> comparison_;
  std::vector<std::uint8_t> pixels_;
  std::unique_ptr<RunHost> host_;
};

// Returns the size of the image that a replay draws.
[[nodiscard]] GlContext::Size image_size(const ReplayRequest& request, const CameraModel& camera);

}  // namespace penumbra
