// The frames of a recording's video, lossless or compressed.
#pragma once

#include <optional>
#include <utility>
#include <variant>

#include "app/recording/compressed_video.hpp"
#include "app/recording/recording_source.hpp"
#include "app/recording/video_reader.hpp"
#include "core/propagate.hpp"

namespace penumbra {

class RecordedVideo {
 public:
  [[nodiscard]] static Result<RecordedVideo> open(const Recording& recording) {
    if (!recording.is_video_file()) {
      PENUMBRA_TRY(auto video, VideoReader::open(recording.video));
      return RecordedVideo(std::move(video));
    }
    VideoListing listing;
    listing.offset_ns = recording.video_offset_ns;
    for (const RecordedFrame& frame : recording.frames)
      listing.times_ns.push_back(frame.timestamp_ns);
    PENUMBRA_TRY(auto video, CompressedVideo::open(recording.video, std::move(listing)));
    return RecordedVideo(std::move(video));
  }

  // Skips the next `count` listed frames.
  [[nodiscard]] Result<void> skip(int count) {
    return std::visit([count](auto& video) { return video.skip(count); }, video_);
  }
  // Returns the next listed frame, or nullopt at the end. After the error of a damaged frame, later
  // ones can be read.
  [[nodiscard]] Result<std::optional<Frame>> next() {
    return std::visit([](auto& video) { return video.next(); }, video_);
  }

 private:
  using Video = std::variant<VideoReader, CompressedVideo>;
  explicit RecordedVideo(Video video) : video_(std::move(video)) {}
  Video video_;
};

}  // namespace penumbra
