#include "app/output/background_writer.hpp"

#include <exception>
#include <utility>

namespace penumbra {

BackgroundWriter::BackgroundWriter(std::unique_ptr<FrameWriter> writer, int depth)
    : writer_(std::move(writer)), depth_(depth > 0 ? static_cast<std::size_t>(depth) : 0) {
  if (depth_ > 0) thread_ = std::thread([this] { run(); });
}

BackgroundWriter::~BackgroundWriter() {
  join(true);
}

Result<void> BackgroundWriter::encode(std::uint64_t number, std::int64_t timestamp_ns,
                                      std::span<const std::uint8_t> rgba) {
  const Stopwatch watch;
  auto written = writer_->write(number, timestamp_ns, rgba);
  const StageTime time = watch.elapsed();
  const std::lock_guard lock(mutex_);
  times_.push_back(time);
  return written;
}

Result<void> BackgroundWriter::encode_guarded(const WaitingFrame& frame) {
  try {
    return encode(frame.number, frame.timestamp_ns, frame.rgba);
  } catch (const std::exception& thrown) {
    return fail("{}", thrown.what());
  }
}

void BackgroundWriter::run() {
  while (true) {
    WaitingFrame frame;
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return ended_ || !waiting_.empty(); });
      if (waiting_.empty()) return;
      frame = std::move(waiting_.front());
      waiting_.pop_front();
    }
    changed_.notify_all();
    const auto written = encode_guarded(frame);
    const std::lock_guard lock(mutex_);
    spare_.push_back(std::move(frame.rgba));
    if (!written) {
      error_ = written.error();
      waiting_.clear();
      ended_ = true;
      changed_.notify_all();
      return;
    }
  }
}

void BackgroundWriter::join(bool drop_waiting) {
  {
    const std::lock_guard lock(mutex_);
    ended_ = true;
    if (drop_waiting) waiting_.clear();
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

Result<void> BackgroundWriter::write(std::uint64_t number, std::int64_t timestamp_ns,
                                     std::span<const std::uint8_t> rgba) {
  if (depth_ == 0) return encode(number, timestamp_ns, rgba);
  WaitingFrame frame{number, timestamp_ns, {}};
  {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return error_ || ended_ || waiting_.size() < depth_; });
    if (error_) return tl::unexpected(*error_);
    if (!spare_.empty()) {
      frame.rgba = std::move(spare_.back());
      spare_.pop_back();
    }
  }
  frame.rgba.assign(rgba.begin(), rgba.end());
  {
    const std::lock_guard lock(mutex_);
    if (error_) return tl::unexpected(*error_);
    waiting_.push_back(std::move(frame));
  }
  changed_.notify_all();
  return {};
}

Result<void> BackgroundWriter::finish() {
  join(false);
  if (error_) return tl::unexpected(*error_);
  return writer_->finish();
}

void BackgroundWriter::rescue() {
  join(true);
  writer_->rescue();
}

std::vector<StageTime> BackgroundWriter::take_times() {
  const std::lock_guard lock(mutex_);
  return std::exchange(times_, {});
}

}  // namespace penumbra
