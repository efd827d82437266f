// Composited frames -> video file, by libavformat and libavcodec.
#pragma once

#include "app/output/frame_writer.hpp"

namespace penumbra {

enum class VideoCodec {
  ffv1,  // Matroska, FFV1 version 3 in RGB with a checksum per slice: every pixel comes back
  h264,  // MP4, libx264 in yuv420p: plays everywhere
};

// The same frames give the same bytes. Frames keep their own times (to 1 ms in Matroska, 1/90000 s
// in MP4), counted from the first one. H.264 needs even sides: the last row or column is repeated
// where one is odd.
[[nodiscard]] Result<std::unique_ptr<FrameWriter>> create_video_writer(
    const std::filesystem::path& file, VideoCodec codec, const FrameFormat& format);

}  // namespace penumbra
