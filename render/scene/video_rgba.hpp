// Converts whole video frames to RGBA on the CPU, like video_texel.glsl. Where a CPU draws, this
// takes a fraction of the shader's time (docs/rendering.md#video).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/image/frame.hpp"
#include "core/image/frame_identity.hpp"

namespace penumbra {

// Coefficients in fixed point; see video_rgba.cpp.
struct YuvCoefficients {
  std::int16_t luma, red_v, green_u, green_v, blue_u;
  std::int16_t luma_offset;
};

// Keeps the frame that was converted last.
class VideoRgba {
 public:
  // Converts a frame: rows top to bottom, 4 * width * height bytes, alpha 255. Each value differs
  // from the exactly converted one by at most 1. The result is valid until the next call.
  [[nodiscard]] std::span<const std::uint8_t> convert(const Frame& frame);
  // Returns true if convert() was last called with this frame; bytes() is its result.
  [[nodiscard]] bool holds(const Frame& frame) const { return converted_.matches(frame); }
  [[nodiscard]] std::span<const std::uint8_t> bytes() const {
    return {reinterpret_cast<const std::uint8_t*>(rgba_.data()), 2 * rgba_.size()};
  }

 private:
  void set_chroma(const Frame& frame, int y, const YuvCoefficients& coefficients);

  std::vector<std::uint16_t> rgba_;
  std::vector<std::uint8_t> luma_, u_, v_;  // unpacked samples of a row
  // Contributions of chroma to red, green and blue, for each sample of a row and for each pixel.
  std::array<std::vector<std::int16_t>, 3> sample_chroma_, pixel_chroma_;
  FrameIdentity converted_;
};

}  // namespace penumbra
