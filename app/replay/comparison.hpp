// Draws the same frames with several shadow techniques side by side. All panes have the same
// tracked pose and scene time. Each pane equals the image that a session with its technique draws.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "app/output/pane_grid.hpp"
#include "app/replay/replay_run.hpp"
#include "app/report/run_report.hpp"
#include "app/run/session_host.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "render/gl/context.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

class Comparison {
 public:
  // `options.plan` is ignored, because each technique has a plan. `context` must be current on this
  // thread and outlive the comparison.
  [[nodiscard]] static Result<Comparison> create(GlContext& context,
                                                 std::shared_ptr<const Scene> scene,
                                                 const CameraModel& camera, PoseSource poses,
                                                 const std::vector<ComparedTechnique>& techniques,
                                                 SessionOptions options);

  // See Session::track().
  [[nodiscard]] TrackedFrame track(const Frame& frame) {
    return panes_.front().session->track(frame);
  }
  // See Session::set_map().
  [[nodiscard]] Result<void> set_map(const CameraModel& camera, const TagMap& tags) {
    return panes_.front().session->set_map(camera, tags);
  }
  void set_map_sigma(double sigma_m) { panes_.front().session->set_map_sigma(sigma_m); }
  // Draws all panes. Returns the first pane's frame, with the times and work of all panes added.
  [[nodiscard]] Result<SessionFrame> draw(const TrackedFrame& tracked);
  bool replay_edit(const SceneEdit& edit);
  // Session of the first pane; all panes have the same scene.
  [[nodiscard]] const Session& session() const { return *panes_.front().session; }

  [[nodiscard]] const PaneGrid& grid() const { return grid_; }
  [[nodiscard]] std::vector<PaneReport> reports() const;
  // Adds the GPU times that are available now to the panes' reports.
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

// A comparison in the window. The techniques and the scene can't be edited.
class ComparisonHost final : public RunHost {
 public:
  // All referenced arguments must outlive this object.
  ComparisonHost(const Comparison& comparison, GlContext& context, UploadedImage image,
                 RunRecorder& run, int frame_count)
      : RunHost(run, frame_count),
        comparison_(comparison),
        context_(context),
        image_(std::move(image)) {}

  void present() override { image_.present(comparison_.grid().rgba(), context_.window_size()); }
  [[nodiscard]] std::string save_screenshot() override;
  [[nodiscard]] std::string toggle_walls() override {
    return "the walls of a comparison are hidden by --hide-walls";
  }

 private:
  [[nodiscard]] const Scene& scene() const override { return *comparison_.session().view().scene; }

  const Comparison& comparison_;
  GlContext& context_;
  UploadedImage image_;
};

}  // namespace penumbra
