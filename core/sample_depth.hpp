// Finds the number of bits that a recording's 16-bit images hold.
#pragma once

#include <filesystem>
#include <span>
#include <string>

namespace penumbra {

// A PNG of 16 bits uses the full range by its specification. Machine-vision cameras store 10, 12 or
// 14 bits in it as they are: such a picture is nearly black.
struct SampleDepth {
  int bits = 16;          // 8 to 14, or 16: the full range
  int brightest = 0;      // largest value of the pictures that were looked at
  bool by_chunk = false;  // the pictures' own sBIT chunk says so

  [[nodiscard]] bool reduced() const { return bits < 16; }
  // One clause for people; for a reduced depth.
  [[nodiscard]] std::string text() const;
};

// One depth for all of these pictures: that of their sBIT chunk where all values fit into it (else
// the samples were scaled up, as the specification asks), else the smallest that holds every value.
// Above 14 bits it is 16. At most kMostLookedAt of the pictures are decoded, evenly spread; what
// can't be read or has 8 bits is passed over.
inline constexpr int kMostLookedAt = 256;
[[nodiscard]] SampleDepth sample_depth_of(std::span<const std::filesystem::path> pictures);

}  // namespace penumbra
