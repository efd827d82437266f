// ViewerHosts that live and replay share.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "app/report/run_report.hpp"
#include "app/session/edit_history.hpp"
#include "app/session/placed_object.hpp"
#include "app/session/session.hpp"
#include "app/window/viewer.hpp"

namespace penumbra {

class RunHost : public ViewerHost {
 public:
  // `run` must outlive this object. `frame_count`: number of frames of a recording.
  RunHost(RunRecorder& run, std::optional<int> frame_count)
      : run_(run), frame_count_(frame_count) {}

  // Call this with each frame before the window shows it.
  void observe(const SessionFrame& frame) { last_ = frame; }
  // Sets the folder of the played recording; no screenshots are saved into it.
  void set_played_recording(std::filesystem::path recording) { recording_ = std::move(recording); }

  [[nodiscard]] std::string toggle_recording() override { return "only live is recorded"; }
  void describe(HudState& state, bool debug) const override;

 protected:
  [[nodiscard]] virtual const Scene& scene() const = 0;

  RunRecorder& run_;
  std::optional<int> frame_count_;
  std::optional<std::filesystem::path> recording_;
  std::optional<SessionFrame> last_;
};

class SessionHost : public RunHost {
 public:
  // `session` and `run` must outlive this object.
  SessionHost(Session& session, RunRecorder& run, std::optional<int> frame_count = std::nullopt)
      : RunHost(run, frame_count),
        session_(session),
        first_view_(session.drawn_view()),
        first_nodes_(SessionHost::nodes()) {}

  // Releases the latest frame's buffer, so that the frame can't be drawn again.
  void forget_frame();

  void present() override { session_.present(); }
  [[nodiscard]] SessionView view() const override { return session_.view(); }
  [[nodiscard]] std::vector<HudNode> nodes() const override;
  void edit(const SceneEdit& edit) override { session_.edit(edit); }
  // Sets the rectangle of the tags, beside which objects are put.
  void set_sheet(const Eigen::AlignedBox2d& sheet) { sheet_ = sheet; }
  void begin_move(const std::string& object) override { history_.begin_move(session_, object); }
  [[nodiscard]] std::string add_object(const std::filesystem::path& file) override;
  [[nodiscard]] std::string undo() override { return history_.undo(session_); }
  [[nodiscard]] std::string reset() override { return history_.reset(session_); }
  void start_again() override;
  // Saves the arrangement in the current folder.
  [[nodiscard]] std::string save_scene() override;
  [[nodiscard]] Translucency translucency() const override {
    return session_.drawn_view().translucency;
  }
  void set_translucency(Translucency mode) override;
  void redraw() override;
  // Saves a PNG of the image without the HUD in the current folder.
  [[nodiscard]] std::string save_screenshot() override;
  [[nodiscard]] std::string toggle_smoothing() override;
  [[nodiscard]] std::string toggle_walls() override;
  void describe(HudState& state, bool debug) const override;

 private:
  [[nodiscard]] const Scene& scene() const override { return *session_.view().scene; }

  Session& session_;
  ViewChanged first_view_;  // at the start of the run
  std::vector<HudNode> first_nodes_;
  Eigen::AlignedBox2d sheet_ = sheet_area(nullptr);
  EditHistory history_;
};

// Writes a frame's number, poses and stage times into `state`.
void describe_frame(HudState& state, const SessionFrame& frame, const RunRecorder& run);

// Saves RGBA8 pixels as a PNG, unless the current folder lies in the played `recording`.
// Returns a message for the user.
[[nodiscard]] std::string save_screenshot_png(
    int width, int height, std::span<const std::uint8_t> rgba,
    const std::optional<std::filesystem::path>& recording = {});

// Returns "penumbra-20260131-142305EXTENSION" in the current folder, by the current time; with -2,
// -3, ... if that name exists.
[[nodiscard]] std::filesystem::path free_name(const std::string& extension);
// Returns the first of PATH, PATH-2, PATH-3, ... that does not exist.
[[nodiscard]] std::filesystem::path free_name(const std::filesystem::path& base,
                                              const std::string& extension);

}  // namespace penumbra
