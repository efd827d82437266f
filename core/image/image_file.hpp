// Decodes and encodes images. The first bytes determine the format; the file's name does not.
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
  // Number of bits of a 16-bit PNG's samples that hold the value, 8 to 16. The decoder keeps the
  // upper 8 of these bits; values that need more bits become white. The PNG specification has 16;
  // machine-vision cameras store 10, 12 or 14 (core/image/sample_depth.hpp).
  int sample_bits = 16;
  bool* clamped = nullptr;  // set to true if a value was clamped
};

// Decodes a JPEG without colour conversion into yuv420p, yuv422p, yuv444p or grey8, full range
// BT.601 (JFIF); other chroma layouts become yuv444p. Decodes a PNG into grey8 or rgb24; expands
// palettes, reduces 16 bits to 8, drops alpha. Fails on a truncated or damaged image, even if the
// decoder would conceal the damage; core/image/jpeg_file.hpp lists harmless defects. Sides up to
// 32768 px, 256 Mpx in total. `name` is the image's name in errors. Thread-safe.
[[nodiscard]] Result<Frame> decode_image(std::span<const std::uint8_t> bytes,
                                         const std::string& name,
                                         const DecodeOptions& options = {});
[[nodiscard]] Result<Frame> load_image(const std::filesystem::path& file,
                                       const DecodeOptions& options = {});

// The sample values of a 16-bit PNG; alpha is ignored.
struct SixteenBitSamples {
  int brightest = 0;
  std::optional<int> significant_bits;  // from the sBIT chunk; maximum over the channels
};
// Returns nullopt for a JPEG or a PNG of another depth.
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
// Writes an 8-bit RGB PNG; drops alpha.
[[nodiscard]] Result<void> save_png(const std::filesystem::path& file, int width, int height,
                                    std::span<const std::uint8_t> rgba);
// Encodes an 8-bit grey PNG. `pixels_per_metre` is the print resolution.
[[nodiscard]] Result<std::vector<std::uint8_t>> grey_png(
    ImageView image, std::optional<double> pixels_per_metre = std::nullopt);
[[nodiscard]] Result<void> save_grey_png(const std::filesystem::path& file, ImageView image);

}  // namespace penumbra
