// A frame writer that works on a thread of its own, so that encoding does not hold up what draws.
#pragma once

#include <memory>
#include <vector>

#include "app/output/frame_writer.hpp"
#include "core/stopwatch.hpp"

namespace penumbra {

// Hands frames on to another writer, in the order they came: what is written is the same as
// without it. An error comes out of the next write() or of finish(); frames after it are dropped.
class BackgroundWriter final : public FrameWriter {
 public:
  // At most `depth` frames wait (the memory is bounded: write() waits for a place). Depth 0: no
  // thread, write() itself encodes.
  BackgroundWriter(std::unique_ptr<FrameWriter> writer, int depth);
  ~BackgroundWriter() override;  // drops what waits

  [[nodiscard]] Result<void> write(std::uint64_t number, std::int64_t timestamp_ns,
                                   std::span<const std::uint8_t> rgba) override;
  [[nodiscard]] Result<void> finish() override;
  void rescue() override;

  // How long each frame took to encode, on the thread that did it: those done since the last call.
  [[nodiscard]] std::vector<StageTime> take_times();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
