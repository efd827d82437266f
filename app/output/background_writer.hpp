// A frame writer that encodes on its own thread.
#pragma once

#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include "app/output/frame_writer.hpp"
#include "core/stopwatch.hpp"

namespace penumbra {

// Passes frames to another writer in order. The next write() or finish() returns an error; later
// frames are dropped.
class BackgroundWriter final : public FrameWriter {
 public:
  // At most `depth` frames wait, then write() blocks. Depth 0: no thread, write() encodes.
  BackgroundWriter(std::unique_ptr<FrameWriter> writer, int depth);
  ~BackgroundWriter() override;  // drops waiting frames

  [[nodiscard]] Result<void> write(std::uint64_t number, std::int64_t timestamp_ns,
                                   std::span<const std::uint8_t> rgba) override;
  [[nodiscard]] Result<void> finish() override;
  void rescue() override;

  // Encoding time of each frame since the last call.
  [[nodiscard]] std::vector<StageTime> take_times();

 private:
  struct WaitingFrame {
    std::uint64_t number = 0;
    std::int64_t timestamp_ns = 0;
    std::vector<std::uint8_t> rgba;
  };
  Result<void> encode(std::uint64_t number, std::int64_t timestamp_ns,
                      std::span<const std::uint8_t> rgba);
  Result<void> encode_guarded(const WaitingFrame& frame);
  void run();
  void join(bool drop_waiting);

  const std::unique_ptr<FrameWriter> writer_;  // used by the thread until it is joined
  const std::size_t depth_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<WaitingFrame> waiting_;              // guarded by mutex_
  std::vector<std::vector<std::uint8_t>> spare_;  // unused buffers; guarded by mutex_
  std::vector<StageTime> times_;                  // guarded by mutex_
  std::optional<Error> error_;                    // the first; guarded by mutex_
  bool ended_ = false;                            // guarded by mutex_
  std::thread thread_;
};

}  // namespace penumbra
