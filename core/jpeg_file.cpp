#include "core/jpeg_file.hpp"

#include <turbojpeg.h>

#include <array>
#include <cstdio>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "core/assert.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kCheapPixels = 16'000'000;  // up to here a size is believed as it stands

// The scan limit keeps a small progressive file from costing minutes.
constexpr int kJpegFlags = TJFLAG_LIMITSCANS;
// Cameras fill up their last packet, in front of the end mark; those of USB have up to this many
// bytes. More that no picture needs is a picture that lost its place.
constexpr unsigned kMostFill = 1024;

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
  if (auto ok = check_image_size(static_cast<std::uint64_t>(header.width),
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

}  // namespace

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

}  // namespace penumbra
