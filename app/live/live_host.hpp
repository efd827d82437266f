// A live session in the window: its camera and its recordings.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "app/capture/live_source.hpp"
#include "app/live/live_recorder.hpp"
#include "app/live/live_run.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "app/session/session_host.hpp"
#include "core/stopwatch.hpp"

namespace penumbra {

class LiveHost final : public SessionHost {
 public:
  // All outlive this.
  LiveHost(Session& session, RunRecorder& run, LiveSource& source, LiveRecorder& recorder,
           const LiveRequest& request);

  [[nodiscard]] std::string toggle_recording() override;
  void describe(HudState& state, bool debug) const override;

  // Returns true once the requested duration has passed, counted from the first image. Without any
  // image it counts from the start, but allows at least the time that a slow camera needs.
  [[nodiscard]] bool is_over() const override;
  // Why the session has no frame, and the remedy.
  [[nodiscard]] std::string no_frame_text() const;
  // A complete image came.
  void set_live();
  // No complete image came for this long, which is longer than usual.
  void set_stalled(std::int64_t stall_ns);

 private:
  const RunRecorder& run_;
  LiveSource& source_;
  LiveRecorder& recorder_;
  const LiveRequest& request_;
  Stopwatch watch_;  // since the first image, or since the start
  bool has_begun_ = false;
  std::optional<double> stall_s_;
  std::uint64_t damaged_ = 0;  // frames before the last complete one
};

}  // namespace penumbra
