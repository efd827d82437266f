// Finds a JPEG image in a file or a camera's buffer by its markers (ITU-T T.81, annex B), without
// decoding blocks.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

// Maximum number of stray bytes that is harmless. Cameras pad their final USB packet before the end
// marker; some write up to 9 bytes before other markers. Lost data causes 100 or more.
inline constexpr std::size_t kMaxFillBytes = 1024;  // before the end marker
inline constexpr std::size_t kMaxStrayBytes = 16;   // before any other marker

struct JpegOutline {
  // From the final start marker through the end marker; if it is missing, through the last byte
  // that may belong to the image.
  std::span<const std::uint8_t> bytes;
  bool has_end_mark = false;
  int width = 0;                // [px]
  int height = 0;               // [px]
  int block_height = 8;         // height of a minimum coded unit [px], usually 8 or 16
  std::size_t size_offset = 0;  // offset in `bytes` of the two bytes that hold the height
};

// The error holds only the cause ("ends within its headers"), without the file's name.
[[nodiscard]] Result<JpegOutline> outline_jpeg(std::span<const std::uint8_t> bytes);

// Returns the image with an end marker and without surrounding bytes. Reduces its height to
// `height` [px] if the number of block rows stays the same.
[[nodiscard]] std::vector<std::uint8_t> normalized_jpeg(const JpegOutline& outline, int height);

}  // namespace penumbra
