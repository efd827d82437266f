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

  // Returns the next frame, or nullopt at the end. Errors name the file or device and the remedy.
  [[nodiscard]] virtual Result<std::optional<Frame>> next() = 0;
  // Time for reading and decoding the latest frame, on the thread that did it.
  [[nodiscard]] virtual StageTime capture_time() const = 0;
  // Number of undecodable frames skipped so far; 0 for a source that fails on such a frame.
  [[nodiscard]] virtual std::int64_t damaged() const { return 0; }
  // Total number of frames, including skipped ones, if known.
  [[nodiscard]] virtual std::optional<int> frame_count() const = 0;
};

}  // namespace penumbra
