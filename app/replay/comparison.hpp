// The same frames with several shadow techniques, side by side: every pane has the same tracked
// pose and the same time of the scene, and is the picture that its technique alone gives.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "app/output/pane_grid.hpp"
#include "app/replay/replay_run.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "app/window/viewer.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/context.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

class Comparison {
 public:
  // `options.plan` is not used: each technique brings its own. `context` is current on this thread
  // and outlives the comparison.
  [[nodiscard]] static Result<Comparison> create(GlContext& context,
                                                 std::shared_ptr<const Scene> scene,
                                                 const CameraModel& camera, PoseSource poses,
                                                 const std::vector<ComparedTechnique>& techniques,
                                                 SessionOptions options);

  // As of a Session.
  [[nodiscard]] TrackedFrame track(const Frame& frame) {
    return panes_.front().session->track(frame);
  }
  // Every pane. What is given back is all of them together: of plans and events that of the first,
  // of times and work the sum.
  [[nodiscard]] Result<SessionFrame> draw(const TrackedFrame& tracked);
  bool replay_edit(const SceneEdit& edit);
  // As a Session's; of all panes alike.
  [[nodiscard]] int samples() const { return panes_.front().session->samples(); }
  [[nodiscard]] bool pixel_buffers() const { return panes_.front().session->pixel_buffers(); }

  // Panes differ in how shadows are drawn, not in the scene.
  [[nodiscard]] const Scene& scene() const { return *panes_.front().session->view().scene; }
  // The last picture.
  [[nodiscard]] const PaneGrid& grid() const { return grid_; }
  [[nodiscard]] std::vector<PaneReport> reports() const;
  // The GPU's times that no frame told of yet go to the panes' reports.
  void take_gpu_times();

 private:
  struct Pane {
    std::string name;
    std::unique_ptr<Session> session;
    std::unique_ptr<RunRecorder> run;
  };
  Comparison(const CameraModel& camera, const std::vector<std::string>& names);

  std::vector<Pane> panes_;
  PaneGrid grid_;
  std::vector<std::uint8_t> pixels_;
};

// A comparison in the window. Each pane keeps its technique, and nothing can be taken.
class ComparisonHost : public ViewerHost {
 public:
  // All outlive this.
  ComparisonHost(const Comparison& comparison, GlContext& context, UploadedPicture picture,
                 const RunRecorder& run, int frame_count)
      : comparison_(comparison),
        context_(context),
        picture_(std::move(picture)),
        run_(run),
        frame_count_(frame_count) {}

  // What the window is about to show.
  void saw(const SessionFrame& frame) { last_ = frame; }
  // As SessionHost's.
  void keep_out_of(std::filesystem::path recording) { recording_ = std::move(recording); }
  void present() override { picture_.present(comparison_.grid().rgba(), context_.window_size()); }
  [[nodiscard]] std::string save_screenshot() override;
  [[nodiscard]] std::string toggle_recording() override { return "only live is recorded"; }
  void describe(HudState& state, bool debug) const override;

 private:
  const Comparison& comparison_;
  GlContext& context_;
  UploadedPicture picture_;
  const RunRecorder& run_;
  int frame_count_;
  std::optional<std::filesystem::path> recording_;
  std::optional<SessionFrame> last_;
};

}  // namespace penumbra
