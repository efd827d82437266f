// A camera's pictures, tracked, one after another, for whoever draws them: always the newest.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>

#include "app/capture/frame_pace.hpp"
#include "app/capture/live_source.hpp"
#include "app/capture/mailbox.hpp"
#include "app/live/draw_pace.hpp"
#include "core/error.hpp"
#include "core/stopwatch.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {

// The monotonic clock, which drivers stamp frames with.
[[nodiscard]] std::int64_t monotonic_ns();

// A frame with its pose, on its way to be drawn.
struct ReadyFrame {
  TrackedFrame tracked;
  StageTime capture_time;  // to decode it
};

// The camera's thread and, unless frames are tracked by whoever takes them, the tracker's. The
// newest picture waits for the tracker, older ones are dropped; a tracked frame is always drawn.
// The tracker begins with a picture as late as it can be ready in time (DrawPace): what waited for
// a slow drawer would be old when it is seen.
class LivePipeline {
 public:
  using Track = std::function<TrackedFrame(const Frame&)>;
  // Each picture as it comes, on the camera's thread; must not wait.
  using Captured = std::function<void(const CapturedImage&)>;

  // `source` outlives this and is stopped at its end.
  LivePipeline(LiveSource& source, Track track, Captured captured, bool side_by_side);
  LivePipeline(const LivePipeline&) = delete;
  LivePipeline& operator=(const LivePipeline&) = delete;
  ~LivePipeline();

  // Nothing where none came in time, or it was damaged.
  [[nodiscard]] std::optional<ReadyFrame> take(std::chrono::milliseconds patience);
  // Nothing will come any more.
  [[nodiscard]] bool finished() const;
  // For how long there was no whole picture, where that is longer than is usual of the camera: what
  // is on the screen is not live.
  [[nodiscard]] std::optional<std::int64_t> stale_for_ns() const;
  void stop();
  // Why it ended by itself, if not well. What the tracker throws is an error too; where frames are
  // tracked by take(), it throws that.
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
  // A whole picture is being tracked; else when the last one was decoded or tracked.
  std::atomic<bool> tracking_now_ = false;
  std::atomic<std::int64_t> last_whole_ns_;
  FramePace pace_;  // of whole pictures; the tracker's thread's
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
