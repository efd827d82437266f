// Lossless video -> frames: Matroska with FFV1 (or raw planes), through libav.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>

#include "core/error.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

class VideoReader {
 public:
  // Fails on anything but a Matroska file whose video is FFV1 or raw.
  [[nodiscard]] static Result<VideoReader> open(const std::filesystem::path& file);
  VideoReader(VideoReader&&) noexcept;
  VideoReader& operator=(VideoReader&&) noexcept;
  ~VideoReader();

  // Reads over the next `count` frames, those that are damaged too; only what the frame after them
  // builds on is decoded.
  [[nodiscard]] Result<void> skip(int count);
  // The next frame as stored, viewing the decoder's memory; RGB layouts become rgb24. Sequence and
  // timestamp are 0: the times in the file are never read. Nothing at the end. Damage (a check sum
  // that is wrong, a block that is lost) is an error; of a single frame it is one of this frame and
  // of those that build on it, and reading goes on after them.
  [[nodiscard]] Result<std::optional<Frame>> next();

 private:
  struct Impl;
  explicit VideoReader(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// How many whole frames the file holds, without decoding them. A file that was cut off counts up to
// its last whole one.
[[nodiscard]] Result<int> count_video_frames(const std::filesystem::path& file);

}  // namespace penumbra
