#include "app/output/background_writer.hpp"

#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

namespace penumbra {
namespace {

struct WaitingFrame {
  std::uint64_t number = 0;
  std::int64_t timestamp_ns = 0;
  std::vector<std::uint8_t> rgba;
};

}  // namespace

struct BackgroundWriter::Impl {
  std::unique_ptr<FrameWriter> writer;  // used by the thread until it is joined
  std::size_t depth = 0;

  std::mutex mutex;
  std::condition_variable changed;
  std::deque<WaitingFrame> waiting;              // guarded by mutex
  std::vector<std::vector<std::uint8_t>> spare;  // buffers to use again; guarded by mutex
  std::vector<StageTime> times;                  // guarded by mutex
  std::optional<Error> error;                    // the first; guarded by mutex
  bool ended = false;                            // no more frames come; guarded by mutex
  std::thread thread;

  Result<void> encode(std::uint64_t number, std::int64_t timestamp_ns,
                      std::span<const std::uint8_t> rgba) {
    const Stopwatch watch;
    auto written = writer->write(number, timestamp_ns, rgba);
    const StageTime time = watch.elapsed();
    const std::lock_guard lock(mutex);
    times.push_back(time);
    return written;
  }

  Result<void> encode_guarded(const WaitingFrame& frame) {
    try {
      return encode(frame.number, frame.timestamp_ns, frame.rgba);
    } catch (const std::exception& thrown) {
      return fail("{}", thrown.what());
    }
  }

  void run() {
    while (true) {
      WaitingFrame frame;
      {
        std::unique_lock lock(mutex);
        changed.wait(lock, [this] { return ended || !waiting.empty(); });
        if (waiting.empty()) return;
        frame = std::move(waiting.front());
        waiting.pop_front();
      }
      changed.notify_all();  // there is a place again
      const auto written = encode_guarded(frame);
      const std::lock_guard lock(mutex);
      spare.push_back(std::move(frame.rgba));
      if (!written) {
        error = written.error();
        waiting.clear();
        ended = true;
        changed.notify_all();
        return;
      }
    }
  }

  void join(bool drop_waiting) {
    {
      const std::lock_guard lock(mutex);
      ended = true;
      if (drop_waiting) waiting.clear();
    }
    changed.notify_all();
    if (thread.joinable()) thread.join();
  }
};

BackgroundWriter::BackgroundWriter(std::unique_ptr<FrameWriter> writer, int depth)
    : impl_(std::make_unique<Impl>()) {
  impl_->writer = std::move(writer);
  impl_->depth = depth > 0 ? static_cast<std::size_t>(depth) : 0;
  if (impl_->depth > 0) impl_->thread = std::thread([impl = impl_.get()] { impl->run(); });
}

BackgroundWriter::~BackgroundWriter() {
  impl_->join(true);
}

Result<void> BackgroundWriter::write(std::uint64_t number, std::int64_t timestamp_ns,
                                     std::span<const std::uint8_t> rgba) {
  Impl& impl = *impl_;
  if (impl.depth == 0) return impl.encode(number, timestamp_ns, rgba);
  WaitingFrame frame{number, timestamp_ns, {}};
  {
    std::unique_lock lock(impl.mutex);
    impl.changed.wait(lock,
                      [&] { return impl.error || impl.ended || impl.waiting.size() < impl.depth; });
    if (impl.error) return tl::unexpected(*impl.error);
    if (!impl.spare.empty()) {
      frame.rgba = std::move(impl.spare.back());
      impl.spare.pop_back();
    }
  }
  frame.rgba.assign(rgba.begin(), rgba.end());
  {
    const std::lock_guard lock(impl.mutex);
    if (impl.error) return tl::unexpected(*impl.error);
    impl.waiting.push_back(std::move(frame));
  }
  impl.changed.notify_all();
  return {};
}

Result<void> BackgroundWriter::finish() {
  impl_->join(false);
  if (impl_->error) return tl::unexpected(*impl_->error);
  return impl_->writer->finish();
}

void BackgroundWriter::rescue() {
  impl_->join(true);
  impl_->writer->rescue();
}

std::vector<StageTime> BackgroundWriter::take_times() {
  const std::lock_guard lock(impl_->mutex);
  return std::exchange(impl_->times, {});
}

}  // namespace penumbra
