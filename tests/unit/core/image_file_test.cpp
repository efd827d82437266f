#include "core/image/image_file.hpp"

#include <gtest/gtest.h>
#include <spng.h>
#include <turbojpeg.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "core/text/text.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using Bytes = std::vector<std::uint8_t>;

// A smooth colour image, which JPEG changes little: R varies along x, G along y, B along both.
Bytes smooth_rgb(int width, int height) {
  Bytes rgb;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      rgb.push_back(static_cast<std::uint8_t>(40 + x / 2));
      rgb.push_back(static_cast<std::uint8_t>(60 + y / 2));
      rgb.push_back(static_cast<std::uint8_t>(200 - (x + y) / 4));
    }
  }
  return rgb;
}

Bytes encode_jpeg(const Bytes& rgb, int width, int height, int subsampling, int flags = 0) {
  tjhandle encoder = tjInitCompress();
  unsigned char* data = nullptr;
  unsigned long size = 0;
  EXPECT_EQ(tjCompress2(encoder, rgb.data(), width, 0, height, TJPF_RGB, &data, &size, subsampling,
                        95, flags),
            0);
  Bytes bytes(data, data + size);
  tjFree(data);
  tjDestroy(encoder);
  return bytes;
}

Bytes encode_png(const Bytes& pixels, int width, int height, int color_type, int depth,
                 bool interlaced = false, spng_plte* palette = nullptr) {
  spng_ctx* png = spng_ctx_new(SPNG_CTX_ENCODER);
  spng_ihdr header{};
  header.width = static_cast<std::uint32_t>(width);
  header.height = static_cast<std::uint32_t>(height);
  header.bit_depth = static_cast<std::uint8_t>(depth);
  header.color_type = static_cast<std::uint8_t>(color_type);
  header.interlace_method = interlaced ? 1 : 0;
  EXPECT_EQ(spng_set_option(png, SPNG_ENCODE_TO_BUFFER, 1), 0);
  EXPECT_EQ(spng_set_ihdr(png, &header), 0);
  if (palette != nullptr) {
    EXPECT_EQ(spng_set_plte(png, palette), 0);
  }
  EXPECT_EQ(
      spng_encode_image(png, pixels.data(), pixels.size(), SPNG_FMT_RAW, SPNG_ENCODE_FINALIZE), 0);
  std::size_t size = 0;
  int status = 0;
  void* data = spng_get_png_buffer(png, &size, &status);
  Bytes bytes(static_cast<std::uint8_t*>(data), static_cast<std::uint8_t*>(data) + size);
  std::free(data);
  spng_ctx_free(png);
  return bytes;
}

int sample(const Frame& frame, std::size_t plane, int x, int y) {
  return frame.planes[plane].data[y * frame.planes[plane].stride + x];
}

// Largest difference between the frame's planes and full-range BT.601 of the RGB image. Chroma is
// compared with the mean over the pixels that a sample covers.
double worst_difference(const Frame& frame, const Bytes& rgb) {
  const auto at = [&](int x, int y, std::size_t c) {
    return static_cast<double>(
        rgb[(static_cast<std::size_t>(y) * static_cast<std::size_t>(frame.width) +
             static_cast<std::size_t>(x)) *
                3 +
            c]);
  };
  double worst = 0.0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
    const PixelPlane& plane = frame.planes[i];
    const int step_x = (frame.width + plane.width - 1) / plane.width;
    const int step_y = (frame.height + plane.height - 1) / plane.height;
    for (int y = 0; y < plane.height; ++y) {
      for (int x = 0; x < plane.width; ++x) {
        double expected = 0.0;
        int count = 0;
        for (int v = y * step_y; v < std::min((y + 1) * step_y, frame.height); ++v) {
          for (int u = x * step_x; u < std::min((x + 1) * step_x, frame.width); ++u) {
            const double r = at(u, v, 0);
            const double g = at(u, v, 1);
            const double b = at(u, v, 2);
            if (i == 0) expected += 0.299 * r + 0.587 * g + 0.114 * b;
            if (i == 1) expected += 128.0 - 0.168736 * r - 0.331264 * g + 0.5 * b;
            if (i == 2) expected += 128.0 + 0.5 * r - 0.418688 * g - 0.081312 * b;
            ++count;
          }
        }
        worst = std::max(worst, std::abs(sample(frame, i, x, y) - expected / count));
      }
    }
  }
  return worst;
}

struct JpegCase {
  int subsampling;
  PixelFormat format;
};

class JpegLayouts : public testing::TestWithParam<JpegCase> {};

TEST_P(JpegLayouts, KeepPlanesWithOddSizes) {
  for (const auto& [width, height] : {std::pair{64, 48}, {61, 47}, {17, 16}, {3, 1}, {1, 1}}) {
    const Bytes rgb = smooth_rgb(width, height);
    for (const int flags : {0, TJFLAG_PROGRESSIVE}) {
      const auto frame =
          decode_image(encode_jpeg(rgb, width, height, GetParam().subsampling, flags), "picture");
      ASSERT_TRUE(frame) << frame.error().message;
      EXPECT_EQ(frame->format, GetParam().format);
      EXPECT_EQ(frame->width, width);
      EXPECT_EQ(frame->height, height);
      EXPECT_EQ(frame->planes[0].width, width);
      EXPECT_EQ(frame->planes[0].height, height);
      EXPECT_EQ(frame->color_range, ColorRange::full);
      EXPECT_EQ(frame->color_matrix, ColorMatrix::bt601);
      EXPECT_LT(worst_difference(*frame, rgb), 6.0) << width << "x" << height;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Subsampling, JpegLayouts,
                         testing::Values(JpegCase{TJSAMP_GRAY, PixelFormat::grey8},
                                         JpegCase{TJSAMP_420, PixelFormat::yuv420p},
                                         JpegCase{TJSAMP_422, PixelFormat::yuv422p},
                                         JpegCase{TJSAMP_444, PixelFormat::yuv444p},
                                         JpegCase{TJSAMP_440, PixelFormat::yuv444p},
                                         JpegCase{TJSAMP_411, PixelFormat::yuv444p}),
                         [](const auto& test) {
                           return std::vector<std::string>(
                                      {"Grey", "Yuv420", "Yuv422", "Yuv444", "Yuv440", "Yuv411"})
                               .at(test.index);
                         });

TEST(Jpeg, DecodesGreyWithUnusualSamplingFactors) {
  const Bytes rgb = smooth_rgb(61, 47);
  Bytes bytes = encode_jpeg(rgb, 61, 47, TJSAMP_GRAY);
  const auto usual = decode_image(bytes, "picture");
  ASSERT_TRUE(usual);
  // In a scan of one component, sampling factors have no effect: 2x2 equals 1x1.
  for (std::size_t i = 0; i + 12 < bytes.size(); ++i) {
    if (bytes[i] == 0xFF && bytes[i + 1] == 0xC0) {
      ASSERT_EQ(bytes[i + 11], 0x11);
      bytes[i + 11] = 0x22;
    }
  }
  const auto unusual = decode_image(bytes, "picture");
  ASSERT_TRUE(unusual) << unusual.error().message;
  ASSERT_EQ(unusual->format, PixelFormat::grey8);
  for (int y = 0; y < 47; ++y) {
    for (int x = 0; x < 61; ++x) {
      ASSERT_EQ(sample(*unusual, 0, x, y), sample(*usual, 0, x, y)) << x << ", " << y;
    }
  }
}

TEST(Jpeg, RejectsFileTruncatedBeforeEndMarker) {
  const Bytes whole = encode_jpeg(smooth_rgb(61, 47), 61, 47, TJSAMP_420);
  ASSERT_TRUE(decode_image(whole, "whole"));
  for (std::size_t length = 0; length < whole.size() - 2; ++length) {
    const auto frame = decode_image(std::span(whole).first(length), "cut.jpg");
    ASSERT_FALSE(frame) << "decoded with " << length << " of " << whole.size() << " bytes";
    EXPECT_NE(frame.error().message.find("cut.jpg"), std::string::npos);
    ASSERT_FALSE(decode_rgba(std::span(whole).first(length), "cut.jpg"));
  }
}

TEST(Jpeg, RejectsFileWithDecoderWarning) {
  Bytes bytes = encode_jpeg(smooth_rgb(320, 240), 320, 240, TJSAMP_420);
  // Writes an end marker into the middle of the entropy-coded data.
  bytes[bytes.size() / 2] = 0xFF;
  bytes[bytes.size() / 2 + 1] = 0xD9;
  const auto frame = decode_image(bytes, "broken.jpg");
  ASSERT_FALSE(frame);
  EXPECT_NE(frame.error().message.find("broken.jpg: damaged JPEG"), std::string::npos);
}

// Many webcams put fill bytes before the end marker of every image.
TEST(Jpeg, AcceptsFillBytesBeforeEndMarker) {
  for (const int flags : {0, TJFLAG_PROGRESSIVE}) {
    const Bytes plain = encode_jpeg(smooth_rgb(61, 47), 61, 47, TJSAMP_420, flags);
    const auto expected = decode_image(plain, "plain.jpg");
    const auto expected_rgba = decode_rgba(plain, "plain.jpg");
    ASSERT_TRUE(expected && expected_rgba);
    for (const auto& [fill, accepted] : {std::pair<std::size_t, bool>{1, true},
                                         {2, true},
                                         {7, true},
                                         {511, true},
                                         {1024, true},
                                         {1040, false},
                                         {20000, false}}) {
      for (const std::uint8_t value : {std::uint8_t{0x00}, std::uint8_t{0x5A}}) {
        Bytes filled = plain;
        filled.insert(filled.end() - 2, fill, value);
        const auto frame = decode_image(filled, "filled.jpg");
        const auto rgba = decode_rgba(filled, "filled.jpg");
        ASSERT_EQ(frame.has_value(), accepted) << fill;
        ASSERT_EQ(rgba.has_value(), accepted) << fill;
        if (!accepted) continue;
        EXPECT_EQ(rgba->pixels, expected_rgba->pixels);
        for (std::size_t i = 0; i < 3; ++i) {
          for (int y = 0; y < frame->planes[i].height; ++y) {
            for (int x = 0; x < frame->planes[i].width; ++x) {
              ASSERT_EQ(sample(*frame, i, x, y), sample(*expected, i, x, y)) << fill;
            }
          }
        }
      }
    }
  }
}

// Fill bytes at the end must not hide damage before them.
TEST(Jpeg, RejectsDamageDespiteFillBytes) {
  Bytes bytes = encode_jpeg(smooth_rgb(320, 240), 320, 240, TJSAMP_420);
  bytes.insert(bytes.end() - 2, 3, std::uint8_t{0});
  ASSERT_TRUE(decode_image(bytes, "filled.jpg"));
  // Writes 64 one bits into the entropy-coded data; no Huffman code consists of 16 one bits.
  Bytes bad_code = bytes;
  for (std::size_t i = 0; i < 16; ++i) bad_code[bytes.size() - 60 + i] = i % 2 == 0 ? 0xFF : 0x00;
  const auto bad = decode_image(bad_code, "bad.jpg");
  ASSERT_FALSE(bad);
  EXPECT_NE(bad.error().message.find("bad.jpg: damaged JPEG"), std::string::npos);
  EXPECT_FALSE(decode_rgba(bad_code, "bad.jpg"));
  // Removes bytes in the middle of the entropy-coded data.
  Bytes shorter = bytes;
  shorter.erase(shorter.begin() + static_cast<std::ptrdiff_t>(bytes.size() / 2),
                shorter.end() - 40);
  EXPECT_FALSE(decode_image(shorter, "shorter.jpg"));
  EXPECT_FALSE(decode_rgba(shorter, "shorter.jpg"));
}

TEST(Jpeg, RejectsHeaderWithExcessiveSize) {
  Bytes bytes = encode_jpeg(smooth_rgb(64, 48), 64, 48, TJSAMP_420);
  for (std::size_t i = 0; i + 9 < bytes.size(); ++i) {
    if (bytes[i] == 0xFF && bytes[i + 1] == 0xC0) {
      bytes[i + 5] = bytes[i + 7] = 0x3F;  // 16128 rows and columns: 260 Mpx
    }
  }
  EXPECT_FALSE(decode_image(bytes, "bomb.jpg"));
  EXPECT_FALSE(decode_rgba(bytes, "bomb.jpg"));
}

Bytes encode_grey_ramp(int depth, bool alpha, bool interlaced) {
  // 9 rows of 16 columns. The grey value depends on the column, at 8 and 16 bits also on the row.
  Bytes raw;
  for (int y = 0; y < 9; ++y) {
    unsigned bits = 0;
    int filled = 0;
    for (int x = 0; x < 16; ++x) {
      const unsigned value = static_cast<unsigned>(x) % (1U << std::min(depth, 4));
      if (depth < 8) {
        bits = (bits << static_cast<unsigned>(depth)) | value;
        filled += depth;
        if (filled == 8) {
          raw.push_back(static_cast<std::uint8_t>(bits));
          bits = 0;
          filled = 0;
        }
        continue;
      }
      raw.push_back(static_cast<std::uint8_t>(16 * x + y));
      if (depth == 16) raw.push_back(0x80);
      if (alpha) raw.insert(raw.end(), static_cast<std::size_t>(depth / 8), 0x55);
    }
  }
  return encode_png(raw, 16, 9, alpha ? SPNG_COLOR_TYPE_GRAYSCALE_ALPHA : SPNG_COLOR_TYPE_GRAYSCALE,
                    depth, interlaced);
}

TEST(Png, ConvertsEveryGreyTypeToEightBits) {
  for (const bool interlaced : {false, true}) {
    for (const int depth : {1, 2, 4, 8, 16}) {
      for (const bool alpha : {false, true}) {
        if (alpha && depth < 8) continue;
        SCOPED_TRACE(testing::Message() << depth << " bits, alpha " << alpha);
        const auto frame = decode_image(encode_grey_ramp(depth, alpha, interlaced), "grey.png");
        ASSERT_TRUE(frame) << frame.error().message;
        ASSERT_EQ(frame->format, PixelFormat::grey8);
        const int levels = (1 << std::min(depth, 4)) - 1;
        for (int y = 0; y < 9; ++y) {
          for (int x = 0; x < 16; ++x) {
            const int expected = depth < 8 ? (x % (levels + 1)) * 255 / levels : 16 * x + y;
            ASSERT_EQ(sample(*frame, 0, x, y), expected) << x << ", " << y;
          }
        }
      }
    }
  }
}

TEST(Png, DecodesColourAndInterlacedImagesExactly) {
  const Bytes rgb = smooth_rgb(61, 47);
  for (const bool interlaced : {false, true}) {
    const auto frame =
        decode_image(encode_png(rgb, 61, 47, SPNG_COLOR_TYPE_TRUECOLOR, 8, interlaced), "picture");
    ASSERT_TRUE(frame) << frame.error().message;
    ASSERT_EQ(frame->format, PixelFormat::rgb24);
    for (int y = 0; y < 47; ++y) {
      ASSERT_EQ(std::memcmp(frame->planes[0].data + y * frame->planes[0].stride,
                            rgb.data() + std::size_t{61} * 3 * static_cast<std::size_t>(y), 61 * 3),
                0)
          << "row " << y;
    }
  }
}

TEST(Png, ConvertsPaletteToRgb) {
  spng_plte palette{};
  palette.n_entries = 2;
  palette.entries[0] = {10, 20, 30, 255};
  palette.entries[1] = {200, 100, 50, 255};
  const Bytes bytes = encode_png({0, 1, 1, 0}, 2, 2, SPNG_COLOR_TYPE_INDEXED, 8, false, &palette);
  const auto frame = decode_image(bytes, "palette.png");
  ASSERT_TRUE(frame) << frame.error().message;
  ASSERT_EQ(frame->format, PixelFormat::rgb24);
  EXPECT_EQ(sample(*frame, 0, 0, 0), 10);
  EXPECT_EQ(sample(*frame, 0, 3, 0), 200);
  EXPECT_EQ(sample(*frame, 0, 5, 1), 30);
}

TEST(Png, RejectsTruncatedFile) {
  const Bytes whole = encode_png(smooth_rgb(16, 12), 16, 12, SPNG_COLOR_TYPE_TRUECOLOR, 8);
  ASSERT_TRUE(decode_image(whole, "whole"));
  for (std::size_t length = 0; length < whole.size(); ++length) {
    ASSERT_FALSE(decode_image(std::span(whole).first(length), "cut.png"))
        << length << " of " << whole.size() << " bytes";
    ASSERT_FALSE(decode_rgba(std::span(whole).first(length), "cut.png"));
  }
}

TEST(Png, RejectsEveryFlippedBit) {
  const Bytes whole = encode_png(smooth_rgb(16, 12), 16, 12, SPNG_COLOR_TYPE_TRUECOLOR, 8);
  for (std::size_t i = 0; i < whole.size(); ++i) {
    Bytes broken = whole;
    broken[i] ^= 0x10U;
    const auto frame = decode_image(broken, "broken.png");
    ASSERT_FALSE(frame) << "byte " << i << " of " << whole.size();
    EXPECT_NE(frame.error().message.find("broken.png"), std::string::npos);
  }
}

TEST(Png, RoundTripsSavedRgbaImages) {
  const test::TemporaryFolder folder;
  const int width = 61;
  const int height = 47;
  const Bytes rgb = smooth_rgb(width, height);
  Bytes rgba;
  for (std::size_t i = 0; i < rgb.size(); i += 3) {
    rgba.insert(rgba.end(), {rgb[i], rgb[i + 1], rgb[i + 2], static_cast<std::uint8_t>(i)});
  }
  const auto file = folder.path() / "saved.png";
  const auto saved = save_png(file, width, height, rgba);
  ASSERT_TRUE(saved) << saved.error().message;
  const auto read = load_rgba(file);
  ASSERT_TRUE(read) << read.error().message;
  ASSERT_EQ(read->width, width);
  ASSERT_EQ(read->height, height);
  for (std::size_t i = 3; i < rgba.size(); i += 4) rgba[i] = 255;
  EXPECT_EQ(read->pixels, rgba);
}

TEST(Png, RoundTripsSavedGreyImages) {
  const test::TemporaryFolder folder;
  constexpr int kWidth = 37;
  constexpr int kHeight = 11;
  constexpr int kStride = 40;
  Bytes grey(std::size_t{kStride} * kHeight);
  for (std::size_t i = 0; i < grey.size(); ++i) grey[i] = static_cast<std::uint8_t>(7 * i);
  const auto file = folder.path() / "grey.png";
  const auto saved = save_grey_png(file, {grey.data(), kWidth, kHeight, kStride});
  ASSERT_TRUE(saved) << saved.error().message;
  const auto read = load_image(file);
  ASSERT_TRUE(read) << read.error().message;
  ASSERT_EQ(read->format, PixelFormat::grey8);
  ASSERT_EQ(read->width, kWidth);
  ASSERT_EQ(read->height, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_EQ(read->planes[0].data[y * read->planes[0].stride + x],
                grey[static_cast<std::size_t>(y * kStride + x)]);
    }
  }
}

TEST(Png, ReportsMissingFolderWhenSaving) {
  const auto saved = save_png("/nonexistent/folder/a.png", 1, 1, Bytes(4));
  ASSERT_FALSE(saved);
  EXPECT_NE(saved.error().message.find("/nonexistent/folder/a.png"), std::string::npos);
}

TEST(DecodeRgba, ReturnsOpaqueJpegCloseToSource) {
  const Bytes rgb = smooth_rgb(61, 47);
  const auto image = decode_rgba(encode_jpeg(rgb, 61, 47, TJSAMP_420), "picture");
  ASSERT_TRUE(image) << image.error().message;
  ASSERT_EQ(image->pixels.size(), std::size_t{61} * 47 * 4);
  for (std::size_t i = 0; i < std::size_t{61} * 47; ++i) {
    EXPECT_EQ(image->pixels[4 * i + 3], 255);
    EXPECT_NEAR(image->pixels[4 * i + 1], rgb[3 * i + 1], 6);
  }
}

TEST(ImageFile, ReportsFilesThatAreNoImages) {
  const test::TemporaryFolder folder;
  EXPECT_NE(load_image(folder.path() / "none.jpg").error().message.find("none.jpg: no such file"),
            std::string::npos);
  EXPECT_NE(load_image(folder.path()).error().message.find("is not a file"), std::string::npos);
  const Bytes text{'h', 'e', 'l', 'l', 'o'};
  ASSERT_TRUE(write_file(folder.path() / "text.jpg", text));
  EXPECT_NE(load_image(folder.path() / "text.jpg").error().message.find("neither JPEG nor PNG"),
            std::string::npos);
  ASSERT_TRUE(write_file(folder.path() / "empty.png", {}));
  EXPECT_NE(load_rgba(folder.path() / "empty.png").error().message.find("empty"),
            std::string::npos);
}

}  // namespace
}  // namespace penumbra
