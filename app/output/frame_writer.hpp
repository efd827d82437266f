// Where composited frames go: a video file or a folder of pictures.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>

#include "core/error.hpp"

namespace penumbra {

struct FrameFormat {
  int width = 0;   // [px]
  int height = 0;  // [px]
  // The usual time from frame to frame: for the encoder's rate and the last frame's duration.
  // Frames keep their own times.
  double frame_interval_s = 1.0 / 30.0;
};

class FrameWriter {
 public:
  FrameWriter() = default;
  FrameWriter(const FrameWriter&) = delete;
  FrameWriter& operator=(const FrameWriter&) = delete;
  // Without finish() nothing is left at the output path.
  virtual ~FrameWriter() = default;

  // `rgba`: RGBA8, rows top to bottom, width * height * 4 bytes; alpha is dropped. Frames come in
  // order of time.
  [[nodiscard]] virtual Result<void> write(std::uint64_t number, std::int64_t timestamp_ns,
                                           std::span<const std::uint8_t> rgba) = 0;
  // Everything is on disk, under its name, when this returns. Nothing was ever written: an error.
  [[nodiscard]] virtual Result<void> finish() = 0;
  // After an error: leaves under its name what was written before, where that can be read; else
  // nothing.
  virtual void rescue() {}
};

enum class OutputKind { ffv1, h264, folder };
// By the extension: .mkv is FFV1 (lossless), .mp4 is H.264, anything else is a folder of pictures.
[[nodiscard]] OutputKind output_kind(const std::filesystem::path& path);

// Fails where the path can't be written or the encoder is not in this libavcodec: before the work
// begins.
[[nodiscard]] Result<std::unique_ptr<FrameWriter>> create_frame_writer(
    const std::filesystem::path& path, const FrameFormat& format);

}  // namespace penumbra
