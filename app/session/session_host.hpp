// A session in the window: what both live and replay give the viewer.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "app/window/viewer.hpp"

namespace penumbra {

class SessionHost : public ViewerHost {
 public:
  // Both outlive this. `frame_count`: of a recording.
  SessionHost(Session& session, RunRecorder& run, std::optional<int> frame_count = std::nullopt)
      : session_(session), run_(run), frame_count_(frame_count) {}

  // What the window is about to show.
  void saw(const SessionFrame& frame);
  // The frame's buffer is wanted back: it can't be drawn again.
  void forget_frame();
  // The recording that is played: nothing is saved into it.
  void keep_out_of(std::filesystem::path recording) { recording_ = std::move(recording); }

  void present() override { session_.present(); }
  [[nodiscard]] SessionView view() const override { return session_.view(); }
  [[nodiscard]] std::vector<HudNode> nodes() const override;
  void edit(const SceneEdit& edit) override;
  [[nodiscard]] Translucency translucency() const override { return session_.translucency(); }
  void set_translucency(Translucency way) override { session_.set_translucency(way); }
  void redraw() override;
  // A PNG of the picture without the HUD, into the current folder.
  [[nodiscard]] std::string save_screenshot() override;
  [[nodiscard]] std::string toggle_recording() override { return "only live is recorded"; }
  [[nodiscard]] std::string toggle_smoothing() override;
  void describe(HudState& state, bool debug) const override;

 private:
  Session& session_;
  RunRecorder& run_;
  std::optional<int> frame_count_;
  std::optional<std::filesystem::path> recording_;
  std::optional<SessionFrame> last_;
};

// What the HUD says of a frame: its number, poses, and the times of the stages.
void describe_frame(HudState& state, const SessionFrame& frame, const RunRecorder& run);
// Lists skipped and reused work of a frame of this scene, as text.
void describe_reasons(HudState& state, const SessionFrame& frame, const Scene& scene);

// A PNG of RGBA8 pixels into the current folder, unless that lies in the `recording` that is
// played. Says what became of it, for the person.
[[nodiscard]] std::string save_picture(int width, int height, std::span<const std::uint8_t> rgba,
                                       const std::optional<std::filesystem::path>& recording = {});

// "penumbra-20260131-142305EXTENSION" in the current folder, by the clock; with -2, -3, ... where
// that is there already.
[[nodiscard]] std::filesystem::path free_name(const std::string& extension);
// PATH, or PATH-2, PATH-3, ...: the first that is not there.
[[nodiscard]] std::filesystem::path free_name(const std::filesystem::path& base,
                                              const std::string& extension);

}  // namespace penumbra
