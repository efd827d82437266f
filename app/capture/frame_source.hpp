// Where frames come from: a recording on disk or a camera. Everything behind this interface looks
// the same to the session.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "core/camera/camera_model.hpp"
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

  // The next frame in order; nothing at the end. An error names the file (or device) and what to
  // do.
  [[nodiscard]] virtual Result<std::optional<Frame>> next() = 0;
  // What reading and decoding the last frame took, on the thread that did it (which may have been
  // ahead of next()).
  [[nodiscard]] virtual StageTime capture_time() const = 0;
  // How many were left out so far because they can't be decoded, where that is no error.
  [[nodiscard]] virtual std::int64_t damaged() const { return 0; }
  // How many frames there will be, with those left out, where that is known.
  [[nodiscard]] virtual std::optional<int> frame_count() const = 0;
};

}  // namespace penumbra
