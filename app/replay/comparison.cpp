#include "app/replay/comparison.hpp"

#include <algorithm>
#include <array>
#include <string_view>

#include "core/assert.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

void add(StageTime& to, const StageTime& time) {
  to.wall_ms += time.wall_ms;
  to.cpu_ms += time.cpu_ms;
}

}  // namespace

Comparison::Comparison(const CameraModel& camera, const std::vector<std::string>& names)
    : grid_(camera.width(), camera.height(), names),
      pixels_(std::size_t{4} * static_cast<std::size_t>(camera.width()) *
              static_cast<std::size_t>(camera.height())) {}

Result<Comparison> Comparison::create(GlContext& context, std::shared_ptr<const Scene> scene,
                                      const CameraModel& camera, PoseSource poses,
                                      const std::vector<ComparedTechnique>& techniques,
                                      SessionOptions options) {
  PENUMBRA_ASSERT(techniques.size() >= kMinPanes && techniques.size() <= kMaxPanes);
  std::vector<std::string> names;
  for (const ComparedTechnique& technique : techniques) names.push_back(technique.name);
  Comparison comparison(camera, names);
  for (std::size_t i = 0; i < techniques.size(); ++i) {
    options.plan = techniques[i].plan;
    options.at_window_size = false;  // the window shows the panes, scaled
    // The first pane tracks the frames for all panes.
    PENUMBRA_TRY(auto session,
                 Session::create(context, scene, camera,
                                 i == 0 ? std::move(poses) : PoseSource(GivenPoses()), options));
    comparison.panes_.push_back({techniques[i].name, std::make_unique<Session>(std::move(session)),
                                 std::make_unique<RunRecorder>()});
  }
  return comparison;
}

Result<SessionFrame> Comparison::draw(const TrackedFrame& tracked) {
  SessionFrame all;
  for (std::size_t i = 0; i < panes_.size(); ++i) {
    Pane& pane = panes_[i];
    auto drawn = pane.session->draw(tracked, pixels_);
    if (!drawn) return drawn;
    grid_.put(i, pixels_);
    pane.run->add_frame(*drawn);
    if (i == 0) {
      all = std::move(*drawn);
      all.composite.gpu_ms.clear();  // the panes' reports contain the GPU times
      continue;
    }
    add(all.composite, drawn->composite);
    add(all.light_time, drawn->light_time);
    add(all.plan_time, drawn->plan_time);
    add(all.draw_time, drawn->draw_time);
    all.plan.skipped.insert(all.plan.skipped.end(), drawn->plan.skipped.begin(),
                            drawn->plan.skipped.end());
  }
  return all;
}

bool Comparison::replay_edit(const SceneEdit& edit) {
  bool known = true;
  for (Pane& pane : panes_) known = pane.session->replay_edit(edit) && known;
  return known;
}

void Comparison::take_gpu_times() {
  for (Pane& pane : panes_) pane.run->add_gpu_times(pane.session->take_gpu_times());
}

std::vector<PaneReport> Comparison::reports() const {
  std::vector<PaneReport> reports;
  for (const Pane& pane : panes_) {
    PaneReport& report = reports.emplace_back(PaneReport{pane.run->report(), pane.name});
    constexpr std::array<std::string_view, 7> kDrawing = {"light", "plan",     "shadow", "render",
                                                          "gpu",   "readback", "draw"};
    std::erase_if(report.time_ms,
                  [&](const auto& time) { return std::ranges::count(kDrawing, time.first) == 0; });
  }
  return reports;
}

std::string ComparisonHost::save_screenshot() {
  const PaneGrid& grid = comparison_.grid();
  return save_screenshot_png(grid.width(), grid.height(), grid.rgba(), recording_);
}

}  // namespace penumbra
