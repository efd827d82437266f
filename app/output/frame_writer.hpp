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
  // Usual interval, for the encoder's rate and the last frame's duration; frames keep their times.
  double frame_interval_s = 1.0 / 30.0;
};

class FrameWriter {
 public:
  FrameWriter() = default;
  FrameWriter(const FrameWriter&) = delete;
  FrameWriter& operator=(const FrameWriter&) = delete;
  // Without finish() nothing is left at the output path.
  virtual ~FrameWriter() = default;

  // `rgba`: RGBA8, rows top to bottom, width * height * 4 bytes; alpha is dropped. In order of
  // time.
  [[nodiscard]] virtual Result<void> write(std::uint64_t number, std::int64_t timestamp_ns,
                                           std::span<const std::uint8_t> rgba) = 0;
  // Puts the complete output under its name. Fails if no frame was written.
  [[nodiscard]] virtual Result<void> finish() = 0;
  // After an error: keeps the frames written before, if they can be read.
  virtual void rescue() {}
};

enum class OutputKind {
  ffv1,   // Matroska, FFV1 version 3 in RGB with a checksum per slice: lossless
  h264,   // MP4, libx264 in yuv420p: plays everywhere
  folder  // PNG images
};
// By the extension: .mkv is FFV1 (lossless), .mp4 is H.264, anything else is a folder of images.
[[nodiscard]] OutputKind output_kind(const std::filesystem::path& path);

// Fails if the path can't be written or this libavcodec has no such encoder.
[[nodiscard]] Result<std::unique_ptr<FrameWriter>> create_frame_writer(
    const std::filesystem::path& path, const FrameFormat& format);

// The same frames give the same bytes. Times (to 1 ms in Matroska, 1/90000 s in MP4) count from the
// first frame. H.264 needs even sides: an odd one repeats its last row or column.
[[nodiscard]] Result<std::unique_ptr<FrameWriter>> create_video_writer(
    const std::filesystem::path& file, OutputKind codec, const FrameFormat& format);

// A folder of 000000.png, 000001.png, ... numbered by frame. Replaces a folder that holds nothing
// but such images; refuses one that holds other files or belongs to a recording.
[[nodiscard]] Result<std::unique_ptr<FrameWriter>> create_png_writer(
    const std::filesystem::path& folder, const FrameFormat& format);

}  // namespace penumbra
