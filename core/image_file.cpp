#include "core/image_file.hpp"

#include <spng.h>
#include <turbojpeg.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "core/assert.hpp"
#include "core/file.hpp"

namespace penumbra {
namespace {

constexpr int kMaxSide = 32768;                     // [px]
constexpr std::size_t kMaxPixels = 256'000'000;     // of one picture
constexpr std::size_t kCheapPixels = 16'000'000;    // up to here a size is believed as it stands
constexpr std::size_t kMaxChunkBytes = 64'000'000;  // of what PNG stores beside the pixels

// The scan limit keeps a small progressive file from costing minutes.
constexpr int kJpegFlags = TJFLAG_LIMITSCANS;
// Cameras fill up their last packet, in front of the end mark; those of USB have up to this many
// bytes. More that no picture needs is a picture that lost its place.
constexpr unsigned kMostFill = 1024;

enum class Kind { jpeg, png };

Result<Kind> kind_of(std::span<const std::uint8_t> bytes, const std::string& name) {
  constexpr std::array<std::uint8_t, 3> kJpeg{0xFF, 0xD8, 0xFF};
  constexpr std::array<std::uint8_t, 8> kPng{0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'};
  const auto starts_with = [&](std::span<const std::uint8_t> magic) {
    return bytes.size() >= magic.size() &&
           std::memcmp(bytes.data(), magic.data(), magic.size()) == 0;
  };
  if (bytes.empty()) return fail("{}: the picture is empty (0 bytes)", name);
  if (starts_with(kJpeg)) return Kind::jpeg;
  if (starts_with(kPng)) return Kind::png;
  return fail("{}: is neither JPEG nor PNG; convert it to one of them", name);
}

Result<void> check_size(std::uint64_t width, std::uint64_t height, const std::string& name) {
  if (width == 0 || height == 0) return fail("{}: picture of {}x{} px", name, width, height);
  if (width > kMaxSide || height > kMaxSide || width * height > kMaxPixels) {
    return fail("{}: picture of {}x{} px; sides go up to {} px and pictures up to {} Mpx", name,
                width, height, kMaxSide, kMaxPixels / 1'000'000);
  }
  return {};
}

// --- JPEG ---

struct DestroyTurbo {
  void operator()(void* handle) const { tjDestroy(handle); }
};
using Turbo = std::unique_ptr<void, DestroyTurbo>;

tl::unexpected<Error> jpeg_failure(tjhandle handle, const std::string& name) {
  return fail("{}: damaged JPEG ({}); record or copy it again", name, tjGetErrorStr2(handle));
}

// Whether a decoder's call went well enough. What it warns of is damage, over which it goes on with
// grey or shifted blocks. But for one thing: bytes between the last block and the end mark, which
// many webcams have in every picture. TurboJPEG keeps the first warning only; nothing is read after
// the end mark, so there is no other.
bool is_decoded(tjhandle handle, int status) {
  if (status == 0) return true;
  if (tjGetErrorCode(handle) != TJERR_WARNING) return false;
  unsigned bytes = 0;
  unsigned marker = 0;
  constexpr unsigned kEndOfImage = 0xD9;
  return std::sscanf(tjGetErrorStr2(handle),
                     "Corrupt JPEG data: %u extraneous bytes before marker 0x%x", &bytes,
                     &marker) == 2 &&
         marker == kEndOfImage && bytes <= kMostFill;
}

struct JpegHeader {
  int width = 0;
  int height = 0;
  int subsampling = -1;  // TJSAMP; -1: a layout that has no name
  int colorspace = -1;   // TJCS
};

Result<JpegHeader> read_jpeg_header(tjhandle handle, std::span<const std::uint8_t> bytes,
                                    const std::string& name) {
  JpegHeader header;
  const int status =
      tjDecompressHeader3(handle, bytes.data(), static_cast<unsigned long>(bytes.size()),
                          &header.width, &header.height, &header.subsampling, &header.colorspace);
  // A size with no subsampling is a layout TurboJPEG has no name for; it still decodes to RGB.
  const bool only_unnamed = header.width > 0 && header.height > 0 && header.subsampling < 0;
  if (status != 0 && !only_unnamed) return jpeg_failure(handle, name);
  if (auto ok = check_size(static_cast<std::uint64_t>(header.width),
                           static_cast<std::uint64_t>(header.height), name);
      !ok) {
    return tl::unexpected(ok.error());
  }
  // A block of 64 pixels takes at least one bit of Huffman code.
  const auto pixels =
      static_cast<std::size_t>(header.width) * static_cast<std::size_t>(header.height);
  if (pixels > kCheapPixels && pixels / 512 > bytes.size()) {
    return fail("{}: damaged JPEG ({} bytes cannot hold {}x{} px); record or copy it again", name,
                bytes.size(), header.width, header.height);
  }
  if (header.colorspace == TJCS_CMYK || header.colorspace == TJCS_YCCK) {
    return fail("{}: is a CMYK JPEG; convert it to RGB", name);
  }
  return header;
}

std::optional<PixelFormat> stored_format(const JpegHeader& header) {
  if (header.colorspace == TJCS_RGB) return std::nullopt;  // its planes are not Y, Cb, Cr
  switch (header.subsampling) {
    case TJSAMP_GRAY:
      return PixelFormat::grey8;
    case TJSAMP_420:
      return PixelFormat::yuv420p;
    case TJSAMP_422:
      return PixelFormat::yuv422p;
    case TJSAMP_444:
      return PixelFormat::yuv444p;
    default:
      return std::nullopt;
  }
}

struct Strides {
  std::array<int, 3> bytes{};
};

Strides strides_of(const Frame& frame) {
  Strides strides;
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
    strides.bytes[i] = static_cast<int>(frame.planes[i].stride);
  }
  return strides;
}

Result<std::vector<std::uint8_t>> decode_jpeg_packed(tjhandle handle,
                                                     std::span<const std::uint8_t> bytes,
                                                     const JpegHeader& header, int pixel_format,
                                                     const std::string& name) {
  const int pitch = header.width * tjPixelSize[pixel_format];
  std::vector<std::uint8_t> pixels(static_cast<std::size_t>(pitch) *
                                   static_cast<std::size_t>(header.height));
  if (!is_decoded(handle,
                  tjDecompress2(handle, bytes.data(), static_cast<unsigned long>(bytes.size()),
                                pixels.data(), header.width, pitch, header.height, pixel_format,
                                kJpegFlags))) {
    return jpeg_failure(handle, name);
  }
  return pixels;
}

Result<Frame> decode_jpeg(std::span<const std::uint8_t> bytes, const std::string& name) {
  const Turbo decoder(tjInitDecompress());
  if (!decoder)
    return fail("{}: the JPEG decoder does not start: {}", name, tjGetErrorStr2(nullptr));
  const Result<JpegHeader> header = read_jpeg_header(decoder.get(), bytes, name);
  if (!header) return tl::unexpected(header.error());

  const std::optional<PixelFormat> format = stored_format(*header);
  if (!format) {
    const auto rgb = decode_jpeg_packed(decoder.get(), bytes, *header, TJPF_RGB, name);
    if (!rgb) return tl::unexpected(rgb.error());
    const Turbo encoder(tjInitCompress());
    if (!encoder) return fail("{}: the JPEG encoder does not start", name);
    FrameBuffer buffer = allocate_frame(PixelFormat::yuv444p, header->width, header->height);
    Strides strides = strides_of(buffer.frame);
    if (tjEncodeYUVPlanes(encoder.get(), rgb->data(), header->width, header->width * 3,
                          header->height, TJPF_RGB, buffer.plane_data.data(), strides.bytes.data(),
                          TJSAMP_444, 0) != 0) {
      return jpeg_failure(encoder.get(), name);
    }
    return std::move(buffer.frame);
  }

  // TurboJPEG fills whole chroma samples: one column or row of luma more than the picture has where
  // a side is odd. The frame then views all but that.
  const int padded_width = tjPlaneWidth(0, header->width, header->subsampling);
  const int padded_height = tjPlaneHeight(0, header->height, header->subsampling);
  PENUMBRA_ASSERT(padded_width >= header->width && padded_height >= header->height);
  FrameBuffer buffer = allocate_frame(*format, padded_width, padded_height);
  Strides strides = strides_of(buffer.frame);
  for (int i = 0; i < buffer.frame.plane_count; ++i) {
    const PixelPlane& plane = buffer.frame.planes[static_cast<std::size_t>(i)];
    PENUMBRA_ASSERT(plane.width == tjPlaneWidth(i, header->width, header->subsampling) &&
                    plane.height == tjPlaneHeight(i, header->height, header->subsampling));
  }
  if (!is_decoded(decoder.get(),
                  tjDecompressToYUVPlanes(decoder.get(), bytes.data(),
                                          static_cast<unsigned long>(bytes.size()),
                                          buffer.plane_data.data(), header->width,
                                          strides.bytes.data(), header->height, kJpegFlags))) {
    return jpeg_failure(decoder.get(), name);
  }
  buffer.frame.width = buffer.frame.planes[0].width = header->width;
  buffer.frame.height = buffer.frame.planes[0].height = header->height;
  return std::move(buffer.frame);
}

Result<RgbaImage> decode_jpeg_rgba(std::span<const std::uint8_t> bytes, const std::string& name) {
  const Turbo decoder(tjInitDecompress());
  if (!decoder)
    return fail("{}: the JPEG decoder does not start: {}", name, tjGetErrorStr2(nullptr));
  const Result<JpegHeader> header = read_jpeg_header(decoder.get(), bytes, name);
  if (!header) return tl::unexpected(header.error());
  auto pixels = decode_jpeg_packed(decoder.get(), bytes, *header, TJPF_RGBA, name);
  if (!pixels) return tl::unexpected(pixels.error());
  return RgbaImage{header->width, header->height, std::move(*pixels)};
}

// --- PNG ---

struct FreePng {
  void operator()(spng_ctx* context) const { spng_ctx_free(context); }
};
using Png = std::unique_ptr<spng_ctx, FreePng>;

tl::unexpected<Error> png_failure(int status, const std::string& name) {
  return fail("{}: damaged PNG ({}); record or copy it again", name, spng_strerror(status));
}

// Whether the chunks reach the end mark with its check sum (libspng does not miss the latter).
bool reaches_end_mark(std::span<const std::uint8_t> bytes) {
  constexpr std::size_t kAround = 12;  // length, type, check sum
  std::size_t at = 8;
  while (at + kAround <= bytes.size()) {
    const std::size_t length = (std::size_t{bytes[at]} << 24U) |
                               (std::size_t{bytes[at + 1]} << 16U) |
                               (std::size_t{bytes[at + 2]} << 8U) | bytes[at + 3];
    if (length > bytes.size() - at - kAround) return false;
    if (std::memcmp(bytes.data() + at + 4, "IEND", 4) == 0) return true;
    at += length + kAround;
  }
  return false;
}

// A decoder over `bytes` that has read the header.
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
  if (auto ok = check_size(header.width, header.height, name); !ok) {
    return tl::unexpected(ok.error());
  }
  return png;
}

// Decodes all rows, `stride` bytes apart, and reads the file to its end mark.
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

// Samples of a 16-bit PNG as they are stored, rows without padding.
struct DeepSamples {
  std::size_t channels = 1;
  std::size_t colours = 1;  // channels without alpha
  std::vector<std::uint16_t> values;
};

Result<DeepSamples> read_deep_samples(spng_ctx* png, const spng_ihdr& header,
                                      const std::string& name) {
  DeepSamples samples;
  const bool grey = header.color_type == SPNG_COLOR_TYPE_GRAYSCALE ||
                    header.color_type == SPNG_COLOR_TYPE_GRAYSCALE_ALPHA;
  const bool alpha = header.color_type == SPNG_COLOR_TYPE_GRAYSCALE_ALPHA ||
                     header.color_type == SPNG_COLOR_TYPE_TRUECOLOR_ALPHA;
  samples.colours = grey ? 1 : 3;
  samples.channels = samples.colours + (alpha ? 1 : 0);
  const std::size_t row = samples.channels * header.width;
  samples.values.resize(row * header.height);
  const std::size_t row_bytes = row * sizeof(std::uint16_t);
  if (auto read = read_png_rows(png, SPNG_FMT_PNG, 0,
                                reinterpret_cast<std::uint8_t*>(samples.values.data()), row_bytes,
                                row_bytes, name);
      !read) {
    return tl::unexpected(read.error());
  }
  return samples;
}

// A 16-bit PNG whose values are in the lowest `sample_bits` bits.
Result<Frame> decode_deep_png(spng_ctx* png, const spng_ihdr& header, const std::string& name,
                              const DecodeOptions& options) {
  const Result<DeepSamples> samples = read_deep_samples(png, header, name);
  if (!samples) return tl::unexpected(samples.error());
  const bool grey = samples->colours == 1;
  FrameBuffer buffer =
      allocate_frame(grey ? PixelFormat::grey8 : PixelFormat::rgb24, static_cast<int>(header.width),
                     static_cast<int>(header.height));
  const auto stride = static_cast<std::size_t>(buffer.frame.planes[0].stride);
  const auto shift = static_cast<unsigned>(options.sample_bits - 8);
  bool clamped = false;
  const std::uint16_t* in = samples->values.data();
  for (std::size_t y = 0; y < header.height; ++y) {
    std::uint8_t* out = buffer.plane_data[0] + y * stride;
    for (std::size_t x = 0; x < header.width; ++x, in += samples->channels) {
      for (std::size_t c = 0; c < samples->colours; ++c) {
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
  const Result<Png> png = open_png(bytes, name, header);
  if (!png) return tl::unexpected(png.error());
  if (header.bit_depth == 16 && options.sample_bits < 16) {
    return decode_deep_png(png->get(), header, name, options);
  }
  const int width = static_cast<int>(header.width);
  const int height = static_cast<int>(header.height);
  const auto columns = static_cast<std::size_t>(width);
  const bool grey = header.color_type == SPNG_COLOR_TYPE_GRAYSCALE ||
                    header.color_type == SPNG_COLOR_TYPE_GRAYSCALE_ALPHA;
  FrameBuffer buffer =
      allocate_frame(grey ? PixelFormat::grey8 : PixelFormat::rgb24, width, height);
  const auto stride = static_cast<std::size_t>(buffer.frame.planes[0].stride);

  // libspng reduces to one grey byte only what has no alpha and up to 8 bits; the rest goes through
  // RGB, whose three channels are then equal.
  const bool through_rgb =
      grey && (header.color_type != SPNG_COLOR_TYPE_GRAYSCALE || header.bit_depth > 8);
  if (!through_rgb) {
    auto read = grey ? read_png_rows(png->get(), SPNG_FMT_G8, 0, buffer.plane_data[0], columns,
                                     stride, name)
                     : read_png_rows(png->get(), SPNG_FMT_RGB8, 0, buffer.plane_data[0],
                                     columns * 3, stride, name);
    if (!read) return tl::unexpected(read.error());
    return std::move(buffer.frame);
  }
  std::vector<std::uint8_t> rgb(columns * 3 * static_cast<std::size_t>(height));
  if (auto read =
          read_png_rows(png->get(), SPNG_FMT_RGB8, 0, rgb.data(), columns * 3, columns * 3, name);
      !read) {
    return tl::unexpected(read.error());
  }
  for (std::size_t y = 0; y < static_cast<std::size_t>(height); ++y) {
    std::uint8_t* out = buffer.plane_data[0] + y * stride;
    const std::uint8_t* in = rgb.data() + y * columns * 3;
    for (std::size_t x = 0; x < columns; ++x) out[x] = in[3 * x];
  }
  return std::move(buffer.frame);
}

Result<RgbaImage> decode_png_rgba(std::span<const std::uint8_t> bytes, const std::string& name) {
  spng_ihdr header{};
  const Result<Png> png = open_png(bytes, name, header);
  if (!png) return tl::unexpected(png.error());
  RgbaImage image{static_cast<int>(header.width), static_cast<int>(header.height), {}};
  const std::size_t row_bytes = std::size_t{4} * header.width;
  image.pixels.resize(row_bytes * header.height);
  if (auto read = read_png_rows(png->get(), SPNG_FMT_RGBA8, SPNG_DECODE_TRNS, image.pixels.data(),
                                row_bytes, row_bytes, name);
      !read) {
    return tl::unexpected(read.error());
  }
  return image;
}

}  // namespace

Result<Frame> decode_image(std::span<const std::uint8_t> bytes, const std::string& name,
                           const DecodeOptions& options) {
  PENUMBRA_ASSERT(options.sample_bits >= 8 && options.sample_bits <= 16);
  const Result<Kind> kind = kind_of(bytes, name);
  if (!kind) return tl::unexpected(kind.error());
  try {
    return *kind == Kind::jpeg ? decode_jpeg(bytes, name) : decode_png(bytes, name, options);
  } catch (const std::bad_alloc&) {
    return fail("{}: no memory for the picture", name);
  }
}

Result<Frame> load_image(const std::filesystem::path& file, const DecodeOptions& options) {
  const auto bytes = read_file(file);
  if (!bytes) return tl::unexpected(bytes.error());
  return decode_image(*bytes, file.string(), options);
}

Result<std::optional<SixteenBitSamples>> sixteen_bit_samples(std::span<const std::uint8_t> bytes,
                                                             const std::string& name) {
  const Result<Kind> kind = kind_of(bytes, name);
  if (!kind) return tl::unexpected(kind.error());
  if (*kind != Kind::png) return std::optional<SixteenBitSamples>();
  try {
    spng_ihdr header{};
    const Result<Png> png = open_png(bytes, name, header);
    if (!png) return tl::unexpected(png.error());
    if (header.bit_depth != 16) return std::optional<SixteenBitSamples>();
    SixteenBitSamples found;
    spng_sbit bits{};
    if (spng_get_sbit(png->get(), &bits) == 0) {
      const bool grey = header.color_type == SPNG_COLOR_TYPE_GRAYSCALE ||
                        header.color_type == SPNG_COLOR_TYPE_GRAYSCALE_ALPHA;
      found.significant_bits =
          grey ? bits.grayscale_bits : std::max({bits.red_bits, bits.green_bits, bits.blue_bits});
    }
    const Result<DeepSamples> samples = read_deep_samples(png->get(), header, name);
    if (!samples) return tl::unexpected(samples.error());
    for (std::size_t at = 0; at < samples->values.size(); at += samples->channels) {
      for (std::size_t c = 0; c < samples->colours; ++c) {
        found.brightest = std::max<int>(found.brightest, samples->values[at + c]);
      }
    }
    return std::optional<SixteenBitSamples>(found);
  } catch (const std::bad_alloc&) {
    return fail("{}: no memory for the picture", name);
  }
}

Result<RgbaImage> decode_rgba(std::span<const std::uint8_t> bytes, const std::string& name) {
  const Result<Kind> kind = kind_of(bytes, name);
  if (!kind) return tl::unexpected(kind.error());
  try {
    return *kind == Kind::jpeg ? decode_jpeg_rgba(bytes, name) : decode_png_rgba(bytes, name);
  } catch (const std::bad_alloc&) {
    return fail("{}: no memory for the picture", name);
  }
}

Result<RgbaImage> load_rgba(const std::filesystem::path& file) {
  const auto bytes = read_file(file);
  if (!bytes) return tl::unexpected(bytes.error());
  return decode_rgba(*bytes, file.string());
}

namespace {

// `samples`: rows without padding, of 1 or 3 bytes for each pixel.
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
