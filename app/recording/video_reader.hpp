// Reads the frames of a lossless video: Matroska with FFV1 or raw planes.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>

#include "core/error.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

class VideoReader {
 public:
  // Fails if the file is not a Matroska file with FFV1 or raw video.
  [[nodiscard]] static Result<VideoReader> open(const std::filesystem::path& file);
  VideoReader(VideoReader&&) noexcept;
  VideoReader& operator=(VideoReader&&) noexcept;
  ~VideoReader();

  // Skips the next `count` frames, including damaged ones. Decodes only those that the next frame
  // needs.
  [[nodiscard]] Result<void> skip(int count);
  // Returns the next frame as stored, a view of the decoder's memory, or nullopt at the end. RGB
  // layouts are converted to rgb24. Sequence and timestamp are 0. Fails for a damaged frame (wrong
  // checksum, lost block) and for each frame that refers to it; later frames can be read.
  [[nodiscard]] Result<std::optional<Frame>> next();

 private:
  struct Impl;
  explicit VideoReader(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// Counts the complete frames without decoding them. The file may be truncated.
[[nodiscard]] Result<int> count_video_frames(const std::filesystem::path& file);

}  // namespace penumbra
