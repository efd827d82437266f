// Source of frames: a recording on disk or a camera.
#pragma once

#include <cstdint>
#include <optional>

#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "core/stopwatch.hpp"

namespace penumbra {

class FrameSource {
 public:
  FrameSource() = default;
  FrameSource(const FrameSource&) = delete;
  FrameSource& operator=(const FrameSource&) = delete;
  virtual ~FrameSource() = default;

  // The next frame in order; empty at the end. An error names the file (or device) and the remedy.
  [[nodiscard]] virtual Result<std::optional<Frame>> next() = 0;
  // Time for reading and decoding the last frame, on the thread that did it (perhaps ahead of
  // next()).
  [[nodiscard]] virtual StageTime capture_time() const = 0;
  // Number of frames skipped so far because they can't be decoded, if that is no error.
  [[nodiscard]] virtual std::int64_t damaged() const { return 0; }
  // Total number of frames, including skipped ones, if known.
  [[nodiscard]] virtual std::optional<int> frame_count() const = 0;
};

}  // namespace penumbra
