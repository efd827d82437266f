// Frame writer that encodes on its own thread.
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

// Passes frames in order to another writer. If the other writer fails, the next write() or finish()
// returns its error, and later frames are dropped.
class BackgroundWriter final : public FrameWriter {
 public:
  // `depth`: capacity of the queue; write() blocks while it is full. 0: no thread, write() encodes.
  BackgroundWriter(std::unique_ptr<FrameWriter> writer, int depth);
  ~BackgroundWriter() override;  // drops queued frames

  [[nodiscard]] Result<void> write(std::uint64_t number, std::int64_t timestamp_ns,
                                   std::span<const std::uint8_t> rgba) override;
  [[nodiscard]] Result<void> finish() override;
  void rescue() override;

  // Returns the encoding time of each frame since the previous call.
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

  const std::unique_ptr<FrameWriter> writer_;  // used only by the thread until join()
  const std::size_t depth_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<WaitingFrame> waiting_;              // guarded by mutex_
  std::vector<std::vector<std::uint8_t>> spare_;  // unused buffers; guarded by mutex_
  std::vector<StageTime> times_;                  // guarded by mutex_
  std::optional<Error> error_;                    // first error; guarded by mutex_
  bool ended_ = false;                            // guarded by mutex_
  std::thread thread_;
};

}  // namespace penumbra
