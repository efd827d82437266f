// ViewerHost of a live session: adds its camera and its recordings.
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
#include "app/run/session_host.hpp"
#include "app/session/session.hpp"
#include "core/stopwatch.hpp"

namespace penumbra {

// Returns the nonzero counts of the camera's faults and restarts, by their names in reports.
[[nodiscard]] std::vector<std::pair<std::string, std::int64_t>> fault_counts(
    const CaptureStats& stats);

class LiveHost final : public SessionHost {
 public:
  // All arguments must outlive this object.
  LiveHost(Session& session, RunRecorder& run, LiveSource& source, LiveRecorder& recorder,
           const LiveRequest& request);

  [[nodiscard]] std::string toggle_recording() override;
  // Ends the session; a calibrated one only if it is called again within some seconds.
  [[nodiscard]] std::string calibrate() override;
  [[nodiscard]] bool calibrates() const { return calibrates_; }
  void describe(HudState& state, bool debug) const override;

  // Returns true after calibrate(), and when the requested duration since the first image is over.
  // If no image has arrived, it counts from the start and waits at least as long as a slow camera
  // needs.
  [[nodiscard]] bool is_over() const override;
  // Returns the error message for a session without frames.
  [[nodiscard]] std::string no_frame_text() const;
  // Call this for each complete image.
  void set_live();
  // Call this if no complete image has arrived for `stall_ns`.
  void set_stalled(std::int64_t stall_ns);

 private:
  LiveSource& source_;
  LiveRecorder& recorder_;
  const LiveRequest& request_;
  Stopwatch watch_;  // since the first image; before it, since the start
  bool has_begun_ = false;
  bool calibrates_ = false;
  std::optional<Stopwatch> since_asked_;  // since calibrate() asked for a second call
  std::optional<double> stall_s_;
  std::uint64_t damaged_ = 0;  // number of damaged frames before the latest complete one
};

}  // namespace penumbra
