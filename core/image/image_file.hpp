// Images in files and in memory. The first bytes decide the kind, never the name.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

struct DecodeOptions {
  // Bits of a 16-bit PNG's samples that hold the value, 8 to 16: the upper 8 of them are kept, and
  // larger values become white. The PNG specification has 16; machine-vision cameras store 10, 12
  // or 14 (core/image/sample_depth.hpp).
  int sample_bits = 16;
  bool* clamped = nullptr;  // set to true if a value was clamped
};

// JPEG -> yuv420p / yuv422p / yuv444p / grey8 as coded, full range BT.601 (JFIF), without colour
// conversion; other chroma layouts become yuv444p. PNG -> grey8 or rgb24 (palette and 16-bit
// reduced, alpha dropped). Fails for a truncated or damaged image, also where a decoder would
// conceal it; core/image/jpeg_file.hpp lists harmless defects of a JPEG. Sides up to 32768 px, 256
// Mpx in all. `name` stands in the error. Thread-safe.
[[nodiscard]] Result<Frame> decode_image(std::span<const std::uint8_t> bytes,
                                         const std::string& name,
                                         const DecodeOptions& options = {});
[[nodiscard]] Result<Frame> load_image(const std::filesystem::path& file,
                                       const DecodeOptions& options = {});

// Values of a 16-bit PNG, without alpha.
struct SixteenBitSamples {
  int brightest = 0;
  std::optional<int> significant_bits;  // by its sBIT chunk, the largest of its channels
};
// Nothing for a JPEG or a PNG of another depth.
[[nodiscard]] Result<std::optional<SixteenBitSamples>> sixteen_bit_samples(
    std::span<const std::uint8_t> bytes, const std::string& name);

// Fails for a size [px] beyond the limits of decode_image().
[[nodiscard]] Result<void> check_image_size(std::uint64_t width, std::uint64_t height,
                                            const std::string& name);

// RGBA8, rows top to bottom, width * 4 bytes apart.
struct RgbaImage {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> pixels;
};
[[nodiscard]] Result<RgbaImage> load_rgba(const std::filesystem::path& file);  // PNG or JPEG
[[nodiscard]] Result<RgbaImage> decode_rgba(std::span<const std::uint8_t> bytes,
                                            const std::string& name);  // PNG or JPEG
// 8-bit RGB PNG; alpha is dropped.
[[nodiscard]] Result<void> save_png(const std::filesystem::path& file, int width, int height,
                                    std::span<const std::uint8_t> rgba);
// 8-bit grey PNG, in memory. `pixels_per_metre`: how large it is printed.
[[nodiscard]] Result<std::vector<std::uint8_t>> grey_png(
    ImageView image, std::optional<double> pixels_per_metre = std::nullopt);
[[nodiscard]] Result<void> save_grey_png(const std::filesystem::path& file, ImageView image);

}  // namespace penumbra
