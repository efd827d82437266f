// Finds a JPEG image in the bytes of a file or of a camera's buffer by its markers (ITU-T T.81,
// annex B). Decodes no block.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

// Bytes that no block needs. Cameras fill up their last USB packet in front of the end mark, and
// some put a few bytes in front of other markers (up to 9 in reports of sound images; where data is
// lost it is a hundred and more).
inline constexpr std::size_t kMostFillBytes = 1024;  // in front of the end mark
inline constexpr std::size_t kMostStrayBytes = 16;   // in front of any other marker

struct JpegOutline {
  // From the start mark through the end mark; without one, to the last byte that may belong to the
  // image. A doubled start mark and what follows the image are cut off.
  std::span<const std::uint8_t> bytes;
  bool has_end_mark = false;
  int width = 0;                // [px]
  int height = 0;               // [px]
  int block_height = 8;         // of the blocks that are coded together: 8 or 16 [px], rarely more
  std::size_t size_offset = 0;  // of the height in `bytes`, two bytes
};

// Errors are the cause alone: "ends within its headers".
[[nodiscard]] Result<JpegOutline> outline_jpeg(std::span<const std::uint8_t> bytes);

// The image as other programs read it: with an end mark, and nothing around it. `height` [px]: cut
// to that many lines where the image has the same rows of blocks with it.
[[nodiscard]] std::vector<std::uint8_t> normalized_jpeg(const JpegOutline& outline, int height);

}  // namespace penumbra
