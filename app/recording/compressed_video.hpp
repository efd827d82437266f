// Reads video files as cameras and phones write them: MP4, MOV, Matroska, AVI, MPEG-TS and others,
// with any codec of libav. The files are untrusted.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

// The container's description of a video; nothing is decoded for it.
struct VideoListing {
  std::vector<std::int64_t> times_ns;  // of the frames, increasing; the first one is at 0 or later
  std::int64_t offset_ns = 0;          // added to the container's times
  std::vector<std::string> notices;    // for the user: rotation, interlaced lines, ...
};

class CompressedVideo {
 public:
  // Reads the times of all frames. Fails if the file is no video, or has no times or no frames.
  [[nodiscard]] static Result<VideoListing> list(const std::filesystem::path& file);
  // `listing`: from list().
  [[nodiscard]] static Result<CompressedVideo> open(const std::filesystem::path& file,
                                                    VideoListing listing);
  CompressedVideo(CompressedVideo&&) noexcept;
  CompressedVideo& operator=(CompressedVideo&&) noexcept;
  ~CompressedVideo();

  // Skips the next `count` listed frames. Decodes them, because later frames build on them.
  [[nodiscard]] Result<void> skip(int count);
  // Returns the next listed frame, upright by the rotation of the container, in 8 bits, or nullopt
  // at the end. Sequence and timestamp are 0. Fails for a damaged frame; later frames can be read.
  [[nodiscard]] Result<std::optional<Frame>> next();

 private:
  struct Impl;
  explicit CompressedVideo(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
