// Damaged images: decoding returns an error or a valid image.
#include <gtest/gtest.h>
#include <spng.h>

#include <cstdlib>
#include <numeric>

#include "core/image/image_file.hpp"
#include "support/mutate.hpp"
#include "support/recording_folder.hpp"

namespace penumbra {
namespace {

std::span<const std::uint8_t> bytes_of(const std::string& text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

// Reads every sample, so that the sanitizers detect planes that are allocated too small.
std::uint64_t sum_of(const Frame& frame) {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
    const PixelPlane& plane = frame.planes[i];
    const int bytes = plane.width * (frame.format == PixelFormat::rgb24 ? 3 : 1);
    for (int y = 0; y < plane.height; ++y) {
      sum = std::accumulate(plane.data + y * plane.stride, plane.data + y * plane.stride + bytes,
                            sum);
    }
  }
  return sum;
}

std::string png_of(int color_type, int depth) {
  const std::size_t bytes_per_pixel =
      (color_type == SPNG_COLOR_TYPE_TRUECOLOR ? 3U : 1U) * (depth == 16 ? 2U : 1U);
  std::string pixels(std::size_t{31} * 23 * bytes_per_pixel, '\0');
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<char>(i * i % 251);
  spng_ctx* png = spng_ctx_new(SPNG_CTX_ENCODER);
  spng_ihdr header{};
  header.width = 31;
  header.height = 23;
  header.bit_depth = static_cast<std::uint8_t>(depth);
  header.color_type = static_cast<std::uint8_t>(color_type);
  spng_set_option(png, SPNG_ENCODE_TO_BUFFER, 1);
  spng_set_ihdr(png, &header);
  spng_encode_image(png, pixels.data(), pixels.size(), SPNG_FMT_RAW, SPNG_ENCODE_FINALIZE);
  std::size_t size = 0;
  int status = 0;
  void* data = spng_get_png_buffer(png, &size, &status);
  std::string bytes(static_cast<const char*>(data), size);
  std::free(data);
  spng_ctx_free(png);
  return bytes;
}

// Bitwise CRC-32 of PNG (ISO 3309). Corrected checksums let the damaged data reach the decoder.
std::uint32_t crc_of(std::string_view bytes) {
  std::uint32_t crc = 0xFFFFFFFFU;
  for (const char c : bytes) {
    crc ^= static_cast<unsigned char>(c);
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1U) ^ ((crc & 1U) != 0 ? 0xEDB88320U : 0U);
  }
  return ~crc;
}

void mend_check_sums(std::string& png) {
  std::size_t at = 8;
  while (at + 12 <= png.size()) {
    std::size_t length = 0;
    for (std::size_t i = 0; i < 4; ++i) {
      length = (length << 8U) | static_cast<unsigned char>(png[at + i]);
    }
    if (length > png.size() - at - 12) return;
    const std::uint32_t crc = crc_of(std::string_view(png).substr(at + 4, length + 4));
    for (std::size_t i = 0; i < 4; ++i) {
      png[at + 8 + length + i] = static_cast<char>((crc >> (24 - 8 * i)) & 0xFFU);
    }
    at += length + 12;
  }
}

struct Tally {
  int inputs = 0;
  int images = 0;
};

void try_one(const std::string& bytes, Tally& tally) {
  ++tally.inputs;
  const auto frame = decode_image(bytes_of(bytes), "fuzz");
  if (frame) {
    ++tally.images;
    ASSERT_GT(frame->width, 0);
    ASSERT_GT(frame->height, 0);
    ASSERT_LT(sum_of(*frame), std::uint64_t{256} * 3 * 256'000'000);
  } else {
    ASSERT_EQ(frame.error().message.find('\n'), std::string::npos);
    ASSERT_TRUE(frame.error().message.starts_with("fuzz: ")) << frame.error().message;
  }
  const auto rgba = decode_rgba(bytes_of(bytes), "fuzz");
  ASSERT_EQ(rgba.has_value(), frame.has_value());
  if (rgba) {
    ASSERT_EQ(rgba->pixels.size(), std::size_t{4} * static_cast<std::size_t>(rgba->width) *
                                       static_cast<std::size_t>(rgba->height));
  }
}

void report(const Tally& tally) {
  testing::Test::RecordProperty("inputs", tally.inputs);
  testing::Test::RecordProperty("pictures", tally.images);
  std::printf("%d inputs, %d decoded, the others refused\n", tally.inputs, tally.images);
}

std::string jpeg_of(int subsampling, int flags) {
  std::string rgb(std::size_t{61} * 47 * 3, '\0');
  for (std::size_t i = 0; i < rgb.size(); ++i) rgb[i] = static_cast<char>(i * 7 / 3);
  tjhandle encoder = tjInitCompress();
  unsigned char* data = nullptr;
  unsigned long size = 0;
  tjCompress2(encoder, reinterpret_cast<const unsigned char*>(rgb.data()), 61, 0, 47, TJPF_RGB,
              &data, &size, subsampling, 75, flags);
  std::string bytes(reinterpret_cast<const char*>(data), size);
  tjFree(data);
  tjDestroy(encoder);
  return bytes;
}

TEST(ImageFuzz, DecodesOrRejectsDamagedJpeg) {
  test::Random random(1);
  Tally tally;
  for (const int subsampling :
       {TJSAMP_GRAY, TJSAMP_420, TJSAMP_422, TJSAMP_444, TJSAMP_440, TJSAMP_411}) {
    for (const int flags : {0, TJFLAG_PROGRESSIVE}) {
      const std::string valid = jpeg_of(subsampling, flags);
      for (int i = 0; i < 400; ++i) {
        // Half of the changes are in the headers with sizes and tables.
        const std::size_t head = i % 2 == 0 ? std::min<std::size_t>(640, valid.size()) : 0;
        const std::string broken =
            head > 0 ? test::mutated(valid.substr(0, head), random) + valid.substr(head)
                     : test::mutated(valid, random);
        ASSERT_NO_FATAL_FAILURE(try_one(broken, tally));
      }
    }
  }
  report(tally);
}

TEST(ImageFuzz, DecodesOrRejectsDamagedPng) {
  test::Random random(2);
  Tally tally;
  for (const auto& [type, depth] : {std::pair{SPNG_COLOR_TYPE_GRAYSCALE, 8},
                                    {SPNG_COLOR_TYPE_GRAYSCALE, 16},
                                    {SPNG_COLOR_TYPE_TRUECOLOR, 8},
                                    {SPNG_COLOR_TYPE_TRUECOLOR, 16}}) {
    const std::string valid = png_of(type, depth);
    for (int i = 0; i < 1000; ++i) {
      std::string broken = test::mutated(valid, random);
      if (i % 4 != 0) mend_check_sums(broken);
      ASSERT_NO_FATAL_FAILURE(try_one(broken, tally));
    }
  }
  report(tally);
}

}  // namespace
}  // namespace penumbra
