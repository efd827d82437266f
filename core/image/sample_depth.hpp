// Finds the number of bits that a recording's 16-bit images hold.
#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>

#include "core/image/image_file.hpp"

namespace penumbra {

// The PNG specification scales samples to the full 16 bits. Machine-vision cameras store 10, 12 or
// 14 bits unscaled: such an image is nearly black.
struct SampleDepth {
  int bits = 16;          // 8 to 14, or 16: the full range
  int brightest = 0;      // largest value of the images that were decoded
  bool by_chunk = false;  // found in the sBIT chunk of the images

  [[nodiscard]] bool reduced() const { return bits < 16; }
  // Message for users, of a reduced depth.
  [[nodiscard]] std::string text() const;
};

// Returns one depth for all images: that of their sBIT chunk if all values fit into it (else the
// samples were scaled up), else the smallest that holds every value; above 14 bits it is 16.
// Decodes at most kMostLookedAt images, evenly spread; ignores unreadable and 8-bit ones.
inline constexpr int kMostLookedAt = 256;
[[nodiscard]] SampleDepth sample_depth_of(std::span<const std::filesystem::path> images);

// Decodes 16-bit images with one depth and warns of values above it, which become white.
class ClampWatch {
 public:
  explicit ClampWatch(int sample_bits) : sample_bits_(sample_bits) {}

  // Options for the next image; valid as long as this object.
  [[nodiscard]] DecodeOptions options() { return {sample_bits_, &clamped_}; }
  // Returns a warning after the first image `name` that was clamped, and nothing later on.
  [[nodiscard]] std::optional<std::string> take_warning(const std::string& name);

 private:
  const int sample_bits_;
  bool clamped_ = false;
  bool warned_ = false;
};

}  // namespace penumbra
