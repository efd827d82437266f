#include "app/live/live_pipeline.hpp"

#include <exception>
#include <utility>

#include "core/units.hpp"

namespace penumbra {

LivePipeline::LivePipeline(LiveSource& source, Track track, Captured captured, bool side_by_side)
    : source_(source),
      track_(std::move(track)),
      captured_(std::move(captured)),
      side_by_side_(side_by_side),
      last_complete_ns_(monotonic_ns()),
      pace_(nanoseconds(source.format().interval_s)),
      stale_after_ns_(pace_.stale_after_ns()) {
  capture_thread_ = std::thread([this] {
    guarded([this] { capture_all(); });
    inbox_.close();  // the tracker still reads its content
  });
  if (!side_by_side_) return;
  tracking_thread_ = std::thread([this] {
    guarded([this] { track_all(); });
    inbox_.close();
    ready_.close();
  });
}

LivePipeline::~LivePipeline() {
  stop();
}

std::optional<ReadyFrame> LivePipeline::take(std::chrono::milliseconds timeout) {
  if (!side_by_side_) return track_next(timeout);
  {
    const std::lock_guard lock(drawer_mutex_);
    draw_pace_.image_requested(monotonic_ns());
    drawer_waits_ = true;
  }
  drawer_changed_.notify_all();
  auto ready = ready_.take(timeout);
  if (ready) {
    {
      const std::lock_guard lock(drawer_mutex_);
      draw_pace_.image_taken(monotonic_ns());
      drawer_waits_ = false;
      ++taken_;
    }
    drawer_changed_.notify_all();
  }
  return ready;
}

bool LivePipeline::finished() const {
  return side_by_side_ ? ready_.finished() : inbox_.finished();
}

std::optional<std::int64_t> LivePipeline::stale_for_ns() const {
  if (tracking_now_) return std::nullopt;
  const std::int64_t age_ns = monotonic_ns() - last_complete_ns_;
  return age_ns < stale_after_ns_ ? std::nullopt : std::optional(age_ns);
}

void LivePipeline::stop() {
  source_.stop();
  {
    const std::lock_guard lock(drawer_mutex_);
    stopping_ = true;
  }
  drawer_changed_.notify_all();
  inbox_.close();
  ready_.close();
  if (capture_thread_.joinable()) capture_thread_.join();
  if (tracking_thread_.joinable()) tracking_thread_.join();
}

std::optional<Error> LivePipeline::error() const {
  const std::lock_guard lock(mutex_);
  return error_;
}

void LivePipeline::guarded(const std::function<void()>& work) {
  try {
    work();
  } catch (const std::exception& error) {
    set_error({error.what()});
  }
  source_.stop();  // if one thread ends, all others end
}

void LivePipeline::set_error(Error error) {
  const std::lock_guard lock(mutex_);
  if (!error_) error_ = std::move(error);
}

void LivePipeline::capture_all() {
  while (true) {
    auto image = source_.next_image();
    if (!image) {
      set_error(image.error());
      return;
    }
    if (!*image) return;
    captured_(**image);
    inbox_.put(std::move(**image));
  }
}

void LivePipeline::track_all() {
  constexpr std::chrono::milliseconds kTakeTimeout(50);
  // Tracks the next image only after the previous one was taken, so that each frame is fresh.
  while (!inbox_.finished() && ready_.wait_until_empty() && wait_for_drawer()) {
    auto ready = track_next(kTakeTimeout);
    if (!ready) continue;
    {
      const std::lock_guard lock(drawer_mutex_);
      ++handed_over_;
    }
    if (!ready_.put_when_empty(std::move(*ready))) break;
  }
}

// Waits until the next image is due or the drawer waits for it. Returns false if the pipeline ends.
bool LivePipeline::wait_for_drawer() {
  std::unique_lock lock(drawer_mutex_);
  // The drawer empties ready_ first and then counts the frame, so this waits for the count.
  drawer_changed_.wait(lock, [this] { return stopping_ || taken_ == handed_over_; });
  if (const auto begin_ns = draw_pace_.begin_at_ns()) {
    const std::chrono::steady_clock::time_point begin{std::chrono::nanoseconds(*begin_ns)};
    drawer_changed_.wait_until(lock, begin, [this] { return stopping_ || drawer_waits_; });
  }
  return !stopping_;
}

std::optional<ReadyFrame> LivePipeline::track_next(std::chrono::milliseconds timeout) {
  auto image = inbox_.take(timeout);
  if (!image) return std::nullopt;
  const Stopwatch watch;
  const std::int64_t begun_ns = monotonic_ns();
  const std::optional<Frame> frame = source_.decode(*image);
  if (!frame) return std::nullopt;
  image.reset();  // returns a JPEG's buffer to the camera
  const StageTime time = watch.elapsed();
  const std::int64_t now_ns = monotonic_ns();
  last_complete_ns_ = now_ns;
  pace_.observe(now_ns);
  stale_after_ns_ = pace_.stale_after_ns();
  tracking_now_ = true;
  ReadyFrame ready{track_(*frame), time};
  last_complete_ns_ = monotonic_ns();
  tracking_now_ = false;
  const std::lock_guard lock(drawer_mutex_);
  draw_pace_.add_preparation(last_complete_ns_ - begun_ns);
  return ready;
}

}  // namespace penumbra
