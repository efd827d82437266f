#include "core/image/image_file.hpp"

#include <spng.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <utility>

#include "core/assert.hpp"
#include "core/image/jpeg_file.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr int kMaxSide = 32768;  // [px]
constexpr std::size_t kMaxPixels = 256'000'000;
constexpr std::size_t kMaxChunkBytes = 64'000'000;  // limit for a PNG's chunks other than pixels

// Calls `jpeg` or `png`, depending on the first bytes.
template <class Jpeg, class Png>
auto decode_by_kind(std::span<const std::uint8_t> bytes, const std::string& name, const Jpeg& jpeg,
                    const Png& png) -> decltype(png()) {
  constexpr std::array<std::uint8_t, 8> kPng{0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'};
  if (bytes.empty()) return fail("{}: the image is empty (0 bytes)", name);
  const bool is_png =
      bytes.size() >= kPng.size() && std::equal(kPng.begin(), kPng.end(), bytes.begin());
  if (!is_png && !is_jpeg(bytes))
    return fail("{}: is neither JPEG nor PNG; convert it to one of them", name);
  try {
    return is_png ? png() : jpeg();
  } catch (const std::bad_alloc&) {
    return fail("{}: no memory for the image", name);
  }
}

struct FreePng {
  void operator()(spng_ctx* context) const { spng_ctx_free(context); }
};
using Png = std::unique_ptr<spng_ctx, FreePng>;

tl::unexpected<Error> png_failure(int status, const std::string& name) {
  return fail("{}: damaged PNG ({}); record or copy it again", name, spng_strerror(status));
}

// Returns true if the image is complete up to the CRC of IEND, which libspng does not require.
bool reaches_end_mark(std::span<const std::uint8_t> bytes) {
  constexpr std::size_t kChunkOverhead = 12;  // [bytes] length, type and CRC of a chunk
  std::size_t at = 8;
  while (at + kChunkOverhead <= bytes.size()) {
    const std::size_t length = (std::size_t{bytes[at]} << 24U) |
                               (std::size_t{bytes[at + 1]} << 16U) |
                               (std::size_t{bytes[at + 2]} << 8U) | bytes[at + 3];
    if (length > bytes.size() - at - kChunkOverhead) return false;
    if (std::memcmp(bytes.data() + at + 4, "IEND", 4) == 0) return true;
    at += length + kChunkOverhead;
  }
  return false;
}

bool is_grey(const spng_ihdr& header) {
  return header.color_type == SPNG_COLOR_TYPE_GRAYSCALE ||
         header.color_type == SPNG_COLOR_TYPE_GRAYSCALE_ALPHA;
}

Result<Png> open_png(std::span<const std::uint8_t> bytes, const std::string& name,
                     spng_ihdr& header) {
  if (!reaches_end_mark(bytes)) {
    return fail("{}: damaged PNG (cut off before its end mark); record or copy it again", name);
  }
  Png png(spng_ctx_new(0));
  if (!png) return fail("{}: no memory for the PNG decoder", name);
  int status = spng_set_png_buffer(png.get(), bytes.data(), bytes.size());
  if (status == 0) status = spng_set_image_limits(png.get(), kMaxSide, kMaxSide);
  if (status == 0) status = spng_set_chunk_limits(png.get(), kMaxChunkBytes, kMaxChunkBytes);
  if (status == 0) status = spng_set_crc_action(png.get(), SPNG_CRC_ERROR, SPNG_CRC_ERROR);
  if (status == 0) status = spng_get_ihdr(png.get(), &header);
  if (status == SPNG_EUSER_WIDTH || status == SPNG_EUSER_HEIGHT) {
    return fail("{}: a side is over {} px", name, kMaxSide);
  }
  if (status != 0) return png_failure(status, name);
  PENUMBRA_TRY_VOID(check_image_size(header.width, header.height, name));
  return png;
}

// Decodes all rows, `stride` bytes apart, and reads the file up to its IEND chunk.
Result<void> read_png_rows(spng_ctx* png, int format, int flags, std::uint8_t* pixels,
                           std::size_t row_bytes, std::size_t stride, const std::string& name) {
  int status = spng_decode_image(png, nullptr, 0, format, flags | SPNG_DECODE_PROGRESSIVE);
  while (status == 0) {
    spng_row_info row{};
    status = spng_get_row_info(png, &row);
    if (status == 0) status = spng_decode_row(png, pixels + row.row_num * stride, row_bytes);
  }
  if (status != SPNG_EOI) return png_failure(status, name);
  status = spng_decode_chunks(png);
  if (status != 0) return png_failure(status, name);
  return {};
}

// All samples of a 16-bit PNG as stored, rows without padding.
struct StoredSamples {
  std::size_t channels = 1;
  std::size_t colours = 1;  // number of channels without alpha
  std::vector<std::uint16_t> values;
};

Result<StoredSamples> read_stored_samples(spng_ctx* png, const spng_ihdr& header,
                                          const std::string& name) {
  StoredSamples samples;
  const bool alpha = header.color_type == SPNG_COLOR_TYPE_GRAYSCALE_ALPHA ||
                     header.color_type == SPNG_COLOR_TYPE_TRUECOLOR_ALPHA;
  samples.colours = is_grey(header) ? 1 : 3;
  samples.channels = samples.colours + (alpha ? 1 : 0);
  const std::size_t row = samples.channels * header.width;
  samples.values.resize(row * header.height);
  const std::size_t row_bytes = row * sizeof(std::uint16_t);
  PENUMBRA_TRY_VOID(read_png_rows(png, SPNG_FMT_PNG, 0,
                                  reinterpret_cast<std::uint8_t*>(samples.values.data()), row_bytes,
                                  row_bytes, name));
  return samples;
}

// Decodes a 16-bit PNG with values in the lowest `sample_bits` bits.
Result<Frame> decode_16_bit_png(spng_ctx* png, const spng_ihdr& header, const std::string& name,
                                const DecodeOptions& options) {
  PENUMBRA_TRY(const StoredSamples samples, read_stored_samples(png, header, name));
  FrameBuffer buffer =
      allocate_frame(is_grey(header) ? PixelFormat::grey8 : PixelFormat::rgb24,
                     static_cast<int>(header.width), static_cast<int>(header.height));
  const auto stride = static_cast<std::size_t>(buffer.frame.planes[0].stride);
  const auto shift = static_cast<unsigned>(options.sample_bits - 8);
  bool clamped = false;
  const std::uint16_t* in = samples.values.data();
  for (std::size_t y = 0; y < header.height; ++y) {
    std::uint8_t* out = buffer.plane_data[0] + y * stride;
    for (std::size_t x = 0; x < header.width; ++x, in += samples.channels) {
      for (std::size_t c = 0; c < samples.colours; ++c) {
        const unsigned value = static_cast<unsigned>(in[c]) >> shift;
        clamped = clamped || value > 255U;
        *out++ = static_cast<std::uint8_t>(std::min(value, 255U));
      }
    }
  }
  if (clamped && options.clamped != nullptr) *options.clamped = true;
  return std::move(buffer.frame);
}

Result<Frame> decode_png(std::span<const std::uint8_t> bytes, const std::string& name,
                         const DecodeOptions& options) {
  spng_ihdr header{};
  PENUMBRA_TRY(const Png png, open_png(bytes, name, header));
  if (header.bit_depth == 16 && options.sample_bits < 16) {
    return decode_16_bit_png(png.get(), header, name, options);
  }
  const int width = static_cast<int>(header.width);
  const int height = static_cast<int>(header.height);
  const auto columns = static_cast<std::size_t>(width);
  const bool grey = is_grey(header);
  FrameBuffer buffer =
      allocate_frame(grey ? PixelFormat::grey8 : PixelFormat::rgb24, width, height);
  const auto stride = static_cast<std::size_t>(buffer.frame.planes[0].stride);

  // libspng can decode only images without alpha and of up to 8 bits into one grey byte. Other grey
  // images are decoded as RGB with three equal channels.
  const bool through_rgb =
      grey && (header.color_type != SPNG_COLOR_TYPE_GRAYSCALE || header.bit_depth > 8);
  if (!through_rgb) {
    PENUMBRA_TRY_VOID(read_png_rows(png.get(), grey ? SPNG_FMT_G8 : SPNG_FMT_RGB8, 0,
                                    buffer.plane_data[0], columns * (grey ? 1 : 3), stride, name));
    return std::move(buffer.frame);
  }
  std::vector<std::uint8_t> rgb(columns * 3 * static_cast<std::size_t>(height));
  PENUMBRA_TRY_VOID(
      read_png_rows(png.get(), SPNG_FMT_RGB8, 0, rgb.data(), columns * 3, columns * 3, name));
  for (std::size_t y = 0; y < static_cast<std::size_t>(height); ++y) {
    std::uint8_t* out = buffer.plane_data[0] + y * stride;
    const std::uint8_t* in = rgb.data() + y * columns * 3;
    for (std::size_t x = 0; x < columns; ++x) out[x] = in[3 * x];
  }
  return std::move(buffer.frame);
}

Result<RgbaImage> decode_png_rgba(std::span<const std::uint8_t> bytes, const std::string& name) {
  spng_ihdr header{};
  PENUMBRA_TRY(const Png png, open_png(bytes, name, header));
  RgbaImage image{static_cast<int>(header.width), static_cast<int>(header.height), {}};
  const std::size_t row_bytes = std::size_t{4} * header.width;
  image.pixels.resize(row_bytes * header.height);
  PENUMBRA_TRY_VOID(read_png_rows(png.get(), SPNG_FMT_RGBA8, SPNG_DECODE_TRNS, image.pixels.data(),
                                  row_bytes, row_bytes, name));
  return image;
}

// `samples` has 1 or 3 bytes per pixel and no padding between rows.
Result<std::vector<std::uint8_t>> encode_png(int width, int height, spng_color_type color,
                                             std::span<const std::uint8_t> samples,
                                             std::optional<double> pixels_per_metre) {
  const Png png(spng_ctx_new(SPNG_CTX_ENCODER));
  if (!png) return fail("no memory for the PNG encoder");
  spng_ihdr header{};
  header.width = static_cast<std::uint32_t>(width);
  header.height = static_cast<std::uint32_t>(height);
  header.bit_depth = 8;
  header.color_type = static_cast<std::uint8_t>(color);
  int status = spng_set_option(png.get(), SPNG_ENCODE_TO_BUFFER, 1);
  if (status == 0) status = spng_set_option(png.get(), SPNG_IMG_COMPRESSION_LEVEL, 1);
  if (status == 0) status = spng_set_option(png.get(), SPNG_FILTER_CHOICE, SPNG_FILTER_CHOICE_SUB);
  if (status == 0) status = spng_set_ihdr(png.get(), &header);
  if (status == 0 && pixels_per_metre) {
    const auto density = static_cast<std::uint32_t>(std::lround(*pixels_per_metre));
    spng_phys physical{density, density, 1};  // per metre
    status = spng_set_phys(png.get(), &physical);
  }
  if (status == 0) {
    status = spng_encode_image(png.get(), samples.data(), samples.size(), SPNG_FMT_PNG,
                               SPNG_ENCODE_FINALIZE);
  }
  if (status != 0) return fail("cannot be encoded: {}", spng_strerror(status));
  struct FreeBytes {
    void operator()(void* bytes) const { std::free(bytes); }
  };
  std::size_t size = 0;
  const std::unique_ptr<void, FreeBytes> encoded(spng_get_png_buffer(png.get(), &size, &status));
  if (!encoded) return fail("cannot be encoded: {}", spng_strerror(status));
  const auto* bytes = static_cast<const std::uint8_t*>(encoded.get());
  return std::vector<std::uint8_t>(bytes, bytes + size);
}

Result<void> write_png(const std::filesystem::path& file,
                       const Result<std::vector<std::uint8_t>>& bytes) {
  if (!bytes) return fail_in(file.string(), bytes.error());
  return write_file(file, *bytes);
}

}  // namespace

Result<void> check_image_size(std::uint64_t width, std::uint64_t height, const std::string& name) {
  if (width == 0 || height == 0) return fail("{}: image of {}x{} px", name, width, height);
  if (width > kMaxSide || height > kMaxSide || width * height > kMaxPixels) {
    return fail("{}: image of {}x{} px; sides go up to {} px and images up to {} Mpx", name, width,
                height, kMaxSide, kMaxPixels / 1'000'000);
  }
  return {};
}

Result<Frame> decode_image(std::span<const std::uint8_t> bytes, const std::string& name,
                           const DecodeOptions& options) {
  PENUMBRA_ASSERT(options.sample_bits >= 8 && options.sample_bits <= 16);
  return decode_by_kind(
      bytes, name, [&] { return decode_jpeg(bytes, name); },
      [&] { return decode_png(bytes, name, options); });
}

Result<Frame> load_image(const std::filesystem::path& file, const DecodeOptions& options) {
  PENUMBRA_TRY(const auto bytes, read_file(file));
  return decode_image(bytes, file.string(), options);
}

Result<std::optional<SixteenBitSamples>> sixteen_bit_samples(std::span<const std::uint8_t> bytes,
                                                             const std::string& name) {
  using Samples = Result<std::optional<SixteenBitSamples>>;
  const auto of_png = [&]() -> Samples {
    spng_ihdr header{};
    PENUMBRA_TRY(const Png png, open_png(bytes, name, header));
    if (header.bit_depth != 16) return std::nullopt;
    SixteenBitSamples found;
    spng_sbit bits{};
    if (spng_get_sbit(png.get(), &bits) == 0) {
      found.significant_bits = is_grey(header)
                                   ? bits.grayscale_bits
                                   : std::max({bits.red_bits, bits.green_bits, bits.blue_bits});
    }
    PENUMBRA_TRY(const StoredSamples samples, read_stored_samples(png.get(), header, name));
    for (std::size_t at = 0; at < samples.values.size(); at += samples.channels) {
      for (std::size_t c = 0; c < samples.colours; ++c) {
        found.brightest = std::max<int>(found.brightest, samples.values[at + c]);
      }
    }
    return found;
  };
  return decode_by_kind(
      bytes, name, [] { return Samples(std::nullopt); }, of_png);
}

Result<RgbaImage> decode_rgba(std::span<const std::uint8_t> bytes, const std::string& name) {
  return decode_by_kind(
      bytes, name, [&] { return decode_jpeg_rgba(bytes, name); },
      [&] { return decode_png_rgba(bytes, name); });
}

Result<RgbaImage> load_rgba(const std::filesystem::path& file) {
  PENUMBRA_TRY(const auto bytes, read_file(file));
  return decode_rgba(bytes, file.string());
}

Result<void> save_png(const std::filesystem::path& file, int width, int height,
                      std::span<const std::uint8_t> rgba) {
  PENUMBRA_ASSERT(width > 0 && height > 0);
  const auto pixels = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  PENUMBRA_ASSERT(rgba.size() == pixels * 4);
  std::vector<std::uint8_t> rgb(pixels * 3);
  for (std::size_t i = 0; i < pixels; ++i) {
    rgb[3 * i] = rgba[4 * i];
    rgb[3 * i + 1] = rgba[4 * i + 1];
    rgb[3 * i + 2] = rgba[4 * i + 2];
  }
  return write_png(file, encode_png(width, height, SPNG_COLOR_TYPE_TRUECOLOR, rgb, std::nullopt));
}

Result<std::vector<std::uint8_t>> grey_png(ImageView image,
                                           std::optional<double> pixels_per_metre) {
  PENUMBRA_ASSERT(!image.empty());
  const auto width = static_cast<std::size_t>(image.width);
  std::vector<std::uint8_t> grey(width * static_cast<std::size_t>(image.height));
  for (int y = 0; y < image.height; ++y)
    std::copy_n(image.row(y), width, grey.begin() + static_cast<std::ptrdiff_t>(width) * y);
  return encode_png(image.width, image.height, SPNG_COLOR_TYPE_GRAYSCALE, grey, pixels_per_metre);
}

Result<void> save_grey_png(const std::filesystem::path& file, ImageView image) {
  return write_png(file, grey_png(image));
}

}  // namespace penumbra
