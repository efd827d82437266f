#include "app/live_pipeline.hpp"

#include <exception>
#include <utility>

#include "core/units.hpp"

namespace penumbra {

std::int64_t monotonic_ns() {
  using Clock = std::chrono::steady_clock;  // CLOCK_MONOTONIC
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch())
      .count();
}

LivePipeline::LivePipeline(LiveSource& source, Track track, Captured captured, bool side_by_side)
    : source_(source),
      track_(std::move(track)),
      captured_(std::move(captured)),
      side_by_side_(side_by_side),
      last_whole_ns_(monotonic_ns()),
      pace_(nanoseconds(source.format().interval_s)),
      stale_after_ns_(pace_.stale_after_ns()) {
  capture_thread_ = std::thread([this] {
    guarded([this] { capture_all(); });
    inbox_.close();  // the tracker goes on with what is in it
  });
  if (!side_by_side_) return;
  tracking_thread_ = std::thread([this] {
    guarded([this] { track_all(); });
    // However it ended, nobody waits for what it would have given or taken.
    inbox_.close();
    ready_.close();
  });
}

LivePipeline::~LivePipeline() {
  stop();
}

std::optional<ReadyFrame> LivePipeline::take(std::chrono::milliseconds patience) {
  return side_by_side_ ? ready_.take(patience) : track_next(patience);
}

bool LivePipeline::finished() const {
  return side_by_side_ ? ready_.finished() : inbox_.finished();
}

std::optional<std::int64_t> LivePipeline::stale_for_ns() const {
  if (tracking_now_) return std::nullopt;
  const std::int64_t age_ns = monotonic_ns() - last_whole_ns_;
  return age_ns < stale_after_ns_ ? std::nullopt : std::optional(age_ns);
}

void LivePipeline::stop() {
  source_.stop();
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
  source_.stop();  // whoever ends, the others have nothing left to do
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
  constexpr std::chrono::milliseconds kPatience(50);
  // A tracked frame that waits to be drawn grows old; a newer picture is taken when it is gone.
  while (!inbox_.finished() && ready_.wait_until_empty()) {
    auto ready = track_next(kPatience);
    if (ready && !ready_.hand_over(std::move(*ready))) break;
  }
}

std::optional<ReadyFrame> LivePipeline::track_next(std::chrono::milliseconds patience) {
  auto image = inbox_.take(patience);
  if (!image) return std::nullopt;
  const Stopwatch watch;
  const std::optional<Frame> frame = source_.decode(*image);
  if (!frame) return std::nullopt;
  image.reset();  // a JPEG's buffer goes back to the camera
  const StageTime time = watch.elapsed();
  const std::int64_t now_ns = monotonic_ns();
  last_whole_ns_ = now_ns;
  pace_.saw(now_ns);
  stale_after_ns_ = pace_.stale_after_ns();
  tracking_now_ = true;
  ReadyFrame ready{track_(*frame), time};
  last_whole_ns_ = monotonic_ns();
  tracking_now_ = false;
  return ready;
}

}  // namespace penumbra
