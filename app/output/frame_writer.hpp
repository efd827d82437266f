// Writers of composited frames: a video file or a folder of PNG images.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>

#include "core/error.hpp"

namespace penumbra {

struct FrameFormat {
  int width = 0;   // [px]
  int height = 0;  // [px]
  // Expected interval; used only for the encoder's rate and the last frame's duration.
  double frame_interval_s = 1.0 / 30.0;
};

class FrameWriter {
 public:
  FrameWriter() = default;
  FrameWriter(const FrameWriter&) = delete;
  FrameWriter& operator=(const FrameWriter&) = delete;
  // Removes the output unless finish() or rescue() was called.
  virtual ~FrameWriter() = default;

  // Writes a frame, in order of time. `rgba`: RGBA8, rows top to bottom, width * height * 4 bytes;
  // alpha is ignored.
  [[nodiscard]] virtual Result<void> write(std::uint64_t number, std::int64_t timestamp_ns,
                                           std::span<const std::uint8_t> rgba) = 0;
  // Completes the output and moves it to its path. Fails if no frame was written.
  [[nodiscard]] virtual Result<void> finish() = 0;
  // Call this after an error. Keeps the frames written before, if the format allows it.
  virtual void rescue() {}
};

enum class OutputKind {
  ffv1,   // Matroska, FFV1 version 3 in RGB with a checksum per slice: lossless
  h264,   // MP4, libx264 in yuv420p: playable everywhere
  folder  // PNG images
};
// Returns the kind by the extension: .mkv is FFV1 (lossless), .mp4 is H.264, others are folders.
[[nodiscard]] OutputKind output_kind(const std::filesystem::path& path);

// Fails if the path can't be written or if the installed libavcodec lacks the encoder.
[[nodiscard]] Result<std::unique_ptr<FrameWriter>> create_frame_writer(
    const std::filesystem::path& path, const FrameFormat& format);

// Equal frames give equal bytes. Times (resolution: 1 ms in Matroska, 1/90000 s in MP4) count from
// the first frame. H.264 requires even sides, so an odd side repeats its last row or column.
[[nodiscard]] Result<std::unique_ptr<FrameWriter>> create_video_writer(
    const std::filesystem::path& file, OutputKind codec, const FrameFormat& format);

// Writes 000000.png, 000001.png, ... numbered by frame. Replaces a folder that contains only such
// images; fails if it contains other files or belongs to a recording.
[[nodiscard]] Result<std::unique_ptr<FrameWriter>> create_png_writer(
    const std::filesystem::path& folder, const FrameFormat& format);

}  // namespace penumbra
