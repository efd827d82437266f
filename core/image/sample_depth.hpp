// Finds the number of bits that a recording's 16-bit images hold.
#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>

#include "core/image/image_file.hpp"

namespace penumbra {

// A PNG of 16 bits uses the full range by its specification. Machine-vision cameras store 10, 12 or
// 14 bits in it as they are: such an image is nearly black.
struct SampleDepth {
  int bits = 16;          // 8 to 14, or 16: the full range
  int brightest = 0;      // largest value of the images that were decoded
  bool by_chunk = false;  // found in the sBIT chunk of the images

  [[nodiscard]] bool reduced() const { return bits < 16; }
  // Message for users, of a reduced depth.
  [[nodiscard]] std::string text() const;
};

// Returns one depth for all of these images: that of their sBIT chunk where all values fit into it
// (else the samples were scaled up, as the specification asks), else the smallest that holds every
// value. Above 14 bits it is 16. At most kMostLookedAt of the images are decoded, evenly spread;
// what can't be read or has 8 bits is ignored.
inline constexpr int kMostLookedAt = 256;
[[nodiscard]] SampleDepth sample_depth_of(std::span<const std::filesystem::path> images);

// Decodes 16-bit images with one depth and warns of values above it, which become white.
class ClampWatch {
 public:
  explicit ClampWatch(int sample_bits) : sample_bits_(sample_bits) {}

  // For the decoder of the next image; valid as long as this object.
  [[nodiscard]] DecodeOptions options() { return {sample_bits_, &clamped_}; }
  // Returns a warning after the first image `name` that was clamped, and nothing later on.
  [[nodiscard]] std::optional<std::string> take_warning(const std::string& name);

 private:
  const int sample_bits_;
  bool clamped_ = false;
  bool warned_ = false;
};

}  // namespace penumbra
