// Captures a camera's images and tracks the newest one for the drawer (the thread that draws).
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>

#include "app/capture/clocks.hpp"
#include "app/capture/frame_clock.hpp"
#include "app/capture/live_source.hpp"
#include "app/capture/mailbox.hpp"
#include "app/live/draw_pace.hpp"
#include "core/error.hpp"
#include "core/stopwatch.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {

// A tracked frame that is ready to be drawn.
struct ReadyFrame {
  TrackedFrame tracked;
  StageTime capture_time;  // time for decoding
};

// Runs the camera's thread and, with `side_by_side`, the tracker's. The newest image waits for the
// tracker; older images are dropped. A tracked frame is always drawn. The tracker starts as late as
// possible (DrawPace), so that frames are fresh.
class LivePipeline {
 public:
  using Track = std::function<TrackedFrame(const Frame&)>;
  // Called for each image on the camera's thread; must not block.
  using Captured = std::function<void(const CapturedImage&)>;

  // `source` must outlive this object; the destructor stops it.
  LivePipeline(LiveSource& source, Track track, Captured captured, bool side_by_side);
  LivePipeline(const LivePipeline&) = delete;
  LivePipeline& operator=(const LivePipeline&) = delete;
  ~LivePipeline();

  // Returns nullopt if no frame is ready in time, or if its image is damaged.
  [[nodiscard]] std::optional<ReadyFrame> take(std::chrono::milliseconds timeout);
  // Returns true after the last frame.
  [[nodiscard]] bool finished() const;
  // Returns how long the stream has stalled without a complete image; nullopt while it is live.
  [[nodiscard]] std::optional<std::int64_t> stale_for_ns() const;
  void stop();
  // Returns the error that ended the pipeline. An exception of the tracker is returned here with
  // `side_by_side`; otherwise take() throws it.
  [[nodiscard]] std::optional<Error> error() const;

 private:
  void guarded(const std::function<void()>& work);
  void set_error(Error error);
  void capture_all();
  void track_all();
  [[nodiscard]] bool wait_for_drawer();
  std::optional<ReadyFrame> track_next(std::chrono::milliseconds timeout);

  LiveSource& source_;
  const Track track_;
  const Captured captured_;
  const bool side_by_side_;
  std::atomic<bool> tracking_now_ = false;      // a complete image is being tracked
  std::atomic<std::int64_t> last_complete_ns_;  // time at which the latest complete image was ready
  FramePace pace_;                              // observes complete images, in the tracker's thread
  std::atomic<std::int64_t> stale_after_ns_;
  Mailbox<CapturedImage> inbox_;
  Mailbox<ReadyFrame> ready_;
  std::mutex drawer_mutex_;
  std::condition_variable drawer_changed_;
  DrawPace draw_pace_;  // guarded by drawer_mutex_, as are the next 4 members
  std::uint64_t handed_over_ = 0, taken_ = 0;  // frames put into ready_, and taken by the drawer
  bool drawer_waits_ = false, stopping_ = false;
  mutable std::mutex mutex_;
  std::optional<Error> error_;  // guarded by mutex_
  std::thread capture_thread_, tracking_thread_;
};

}  // namespace penumbra
