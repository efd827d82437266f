// Frames of a lossless video: Matroska with FFV1 or raw planes.
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

  // Skips the next `count` frames, damaged ones too; decodes only those that the next frame refers
  // to.
  [[nodiscard]] Result<void> skip(int count);
  // The next frame as stored, viewing the decoder's memory; RGB layouts become rgb24. Empty at the
  // end. Sequence and timestamp are 0. Fails on damage (a wrong checksum, a lost block); a damaged
  // frame and those that refer to it fail one by one, and later frames can be read.
  [[nodiscard]] Result<std::optional<Frame>> next();

 private:
  struct Impl;
  explicit VideoReader(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// Number of complete frames, without decoding them; a file may be cut off.
[[nodiscard]] Result<int> count_video_frames(const std::filesystem::path& file);

}  // namespace penumbra
