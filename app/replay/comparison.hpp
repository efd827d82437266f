// Draws the same frames with several shadow techniques side by side. Every pane has the same
// tracked pose and scene time, and is the image that its technique alone gives.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "app/output/pane_grid.hpp"
#include "app/replay/replay_run.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session_host.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
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

  // As Session::track().
  [[nodiscard]] TrackedFrame track(const Frame& frame) {
    return panes_.front().session->track(frame);
  }
  // Draws every pane. Returns the first one's plan and events, and the sums of times and work.
  [[nodiscard]] Result<SessionFrame> draw(const TrackedFrame& tracked);
  bool replay_edit(const SceneEdit& edit);
  // The session of the first pane. The panes have the same scene.
  [[nodiscard]] const Session& session() const { return *panes_.front().session; }

  [[nodiscard]] const PaneGrid& grid() const { return grid_; }
  [[nodiscard]] std::vector<PaneReport> reports() const;
  // Adds the GPU times of the last frames to the panes' reports.
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

// A comparison in the window. Each pane keeps its technique, and nothing can be edited.
class ComparisonHost final : public RunHost {
 public:
  // All outlive this.
  ComparisonHost(const Comparison& comparison, GlContext& context, UploadedPicture picture,
                 RunRecorder& run, int frame_count)
      : RunHost(run, frame_count),
        comparison_(comparison),
        context_(context),
        picture_(std::move(picture)) {}

  void present() override { picture_.present(comparison_.grid().rgba(), context_.window_size()); }
  [[nodiscard]] std::string save_screenshot() override;

 private:
  [[nodiscard]] const Scene& scene() const override { return *comparison_.session().view().scene; }

  const Comparison& comparison_;
  GlContext& context_;
  UploadedPicture picture_;
};

}  // namespace penumbra
