// A live session in the window: its camera and its recordings.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "app/capture/live_source.hpp"
#include "app/live/live_recorder.hpp"
#include "app/live/live_run.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "app/session/session_host.hpp"
#include "core/stopwatch.hpp"

namespace penumbra {

// Counts of the camera's faults and restarts that are not 0, by the names in reports.
[[nodiscard]] std::vector<std::pair<std::string, std::int64_t>> fault_counts(
    const CaptureStats& stats);

class LiveHost final : public SessionHost {
 public:
  // All outlive this.
  LiveHost(Session& session, RunRecorder& run, LiveSource& source, LiveRecorder& recorder,
           const LiveRequest& request);

  [[nodiscard]] std::string toggle_recording() override;
  void describe(HudState& state, bool debug) const override;

  // Returns true after the requested duration from the first image. Without any image it counts
  // from the start and allows at least the time that a slow camera needs.
  [[nodiscard]] bool is_over() const override;
  // The message for a session without frames.
  [[nodiscard]] std::string no_frame_text() const;
  // Call it for each complete image.
  void set_live();
  // Call it if no complete image came for this long.
  void set_stalled(std::int64_t stall_ns);

 private:
  LiveSource& source_;
  LiveRecorder& recorder_;
  const LiveRequest& request_;
  Stopwatch watch_;  // since the first image, or since the start
  bool has_begun_ = false;
  std::optional<double> stall_s_;
  std::uint64_t damaged_ = 0;  // frames before the last complete one
};

}  // namespace penumbra
