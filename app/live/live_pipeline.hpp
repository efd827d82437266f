// Captures and tracks a camera's images for the drawer, always the newest.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>

#include "app/capture/frame_clock.hpp"
#include "app/capture/live_source.hpp"
#include "app/capture/mailbox.hpp"
#include "app/live/draw_pace.hpp"
#include "core/error.hpp"
#include "core/stopwatch.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {

// The monotonic clock, which drivers use for timestamps.
[[nodiscard]] std::int64_t monotonic_ns();

// A tracked frame that is ready to be drawn.
struct ReadyFrame {
  TrackedFrame tracked;
  StageTime capture_time;  // of decoding
};

// Runs the camera's thread and, with `side_by_side`, the tracker's. The newest image waits for the
// tracker, older ones are dropped; a tracked frame is always drawn. The tracker begins as late as
// it can be ready in time (DrawPace), so that frames are fresh.
class LivePipeline {
 public:
  using Track = std::function<TrackedFrame(const Frame&)>;
  // Called with each image on the camera's thread; must not wait.
  using Captured = std::function<void(const CapturedImage&)>;

  // `source` outlives this, which stops it at its end.
  LivePipeline(LiveSource& source, Track track, Captured captured, bool side_by_side);
  LivePipeline(const LivePipeline&) = delete;
  LivePipeline& operator=(const LivePipeline&) = delete;
  ~LivePipeline();

  // Nothing if none came in time, or it was damaged.
  [[nodiscard]] std::optional<ReadyFrame> take(std::chrono::milliseconds patience);
  // Returns true after the last frame.
  [[nodiscard]] bool finished() const;
  // How long the stream has stalled without a complete image; nothing while it is live.
  [[nodiscard]] std::optional<std::int64_t> stale_for_ns() const;
  void stop();
  // The error that ended the pipeline, also an exception of the tracker. Without `side_by_side`,
  // take() throws that.
  [[nodiscard]] std::optional<Error> error() const;

 private:
  void guarded(const std::function<void()>& work);
  void set_error(Error error);
  void capture_all();
  void track_all();
  [[nodiscard]] bool wait_for_drawer();
  std::optional<ReadyFrame> track_next(std::chrono::milliseconds patience);

  LiveSource& source_;
  const Track track_;
  const Captured captured_;
  const bool side_by_side_;
  std::atomic<bool> tracking_now_ = false;   // a complete image
  std::atomic<std::int64_t> last_whole_ns_;  // when the last one was decoded or tracked
  FramePace pace_;                           // of complete images; used by the tracker's thread
  std::atomic<std::int64_t> stale_after_ns_;
  Mailbox<CapturedImage> inbox_;
  Mailbox<ReadyFrame> ready_;
  std::mutex drawer_mutex_;
  std::condition_variable drawer_changed_;
  DrawPace draw_pace_;                         // these are guarded by drawer_mutex_
  std::uint64_t handed_over_ = 0, taken_ = 0;  // tracked frames
  bool drawer_waits_ = false, stopping_ = false;
  mutable std::mutex mutex_;
  std::optional<Error> error_;  // guarded by mutex_
  std::thread capture_thread_, tracking_thread_;
};

}  // namespace penumbra
