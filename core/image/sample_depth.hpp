// Finds how many bits a recording's 16-bit images use.
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
  // Returns the message to users about a reduced depth.
  [[nodiscard]] std::string text() const;
};

// Returns one depth for all images. Uses the sBIT chunk if all values fit into its depth (if not,
// the samples were scaled up). Otherwise uses the smallest depth that fits all values, or 16 above
// 14 bits. Decodes up to kMaxSampledImages images, evenly spaced; ignores unreadable and 8-bit
// ones.
inline constexpr int kMaxSampledImages = 256;
[[nodiscard]] SampleDepth sample_depth_of(std::span<const std::filesystem::path> images);

// Provides options that decode all images with one depth, and warns once if values exceed it.
class ClampWatch {
 public:
  explicit ClampWatch(int sample_bits) : sample_bits_(sample_bits) {}

  // Returns the options for the next image; they refer to this object.
  [[nodiscard]] DecodeOptions options() { return {sample_bits_, &clamped_}; }
  // Call after decoding image `name`. Returns a warning for the first clamped image, else nullopt.
  [[nodiscard]] std::optional<std::string> take_warning(const std::string& name);

 private:
  const int sample_bits_;
  bool clamped_ = false;
  bool warned_ = false;
};

}  // namespace penumbra
