// Finds a JPEG image in the bytes of a file or of a camera's buffer by its markers (ITU-T T.81,
// annex B). Decodes no block.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

// Harmless stray bytes. Cameras fill up their last USB packet in front of the end mark; some put up
// to 9 bytes in front of other markers. Lost data gives a hundred and more.
inline constexpr std::size_t kMostFillBytes = 1024;  // in front of the end mark
inline constexpr std::size_t kMostStrayBytes = 16;   // in front of any other marker

struct JpegOutline {
  // From the (last) start mark through the end mark; without one, to the last byte that may belong
  // to the image.
  std::span<const std::uint8_t> bytes;
  bool has_end_mark = false;
  int width = 0;                // [px]
  int height = 0;               // [px]
  int block_height = 8;         // of a minimum coded unit: 8 or 16 [px], rarely more
  std::size_t size_offset = 0;  // of the height's two bytes in `bytes`
};

// An error is the cause without the file: "ends within its headers".
[[nodiscard]] Result<JpegOutline> outline_jpeg(std::span<const std::uint8_t> bytes);

// Returns the image with an end mark and nothing around it. Cuts it to `height` lines [px] if the
// number of block rows stays the same.
[[nodiscard]] std::vector<std::uint8_t> normalized_jpeg(const JpegOutline& outline, int height);

}  // namespace penumbra
