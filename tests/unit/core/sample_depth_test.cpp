// 16-bit images that use fewer bits. The sample depth is determined from their values or sBIT
// chunks, and is common to all images.
#include "core/image/sample_depth.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include "core/image/image_file.hpp"
#include "core/text/text.hpp"
#include "support/deep_png.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;
using Values = std::vector<std::uint16_t>;

constexpr int kWidth = 16;
constexpr int kHeight = 9;

using Layout = test::DeepPng;

// All channels increase from 0 to `brightest`, except alpha, which is opaque.
Values ramp(int brightest, const Layout& layout = {}) {
  Values values;
  const int colours = layout.channels - (layout.alpha ? 1 : 0);
  const int count = kWidth * kHeight * colours;
  for (int i = 0; i < count; ++i) {
    values.push_back(static_cast<std::uint16_t>(std::int64_t{brightest} * i / (count - 1)));
    if (layout.alpha && (i + 1) % colours == 0) values.push_back(65535);
  }
  return values;
}

std::vector<std::uint8_t> png_of(const Values& values, const Layout& layout = {}) {
  return test::deep_png(values, kWidth, kHeight, layout);
}

class SampleDepthTest : public testing::Test {
 protected:
  void add(const std::vector<std::uint8_t>& bytes) {
    images_.push_back(folder_.path() / (std::to_string(images_.size()) + ".png"));
    ASSERT_TRUE(write_file(images_.back(), bytes));
  }
  [[nodiscard]] SampleDepth found() const { return sample_depth_of(images_); }

  test::TemporaryFolder folder_;
  std::vector<std::filesystem::path> images_;
};

TEST_F(SampleDepthTest, IsSmallestDepthThatHoldsEveryValue) {
  for (const auto& [brightest, bits] : {std::pair{0, 16},
                                        {1, 8},
                                        {255, 8},
                                        {256, 9},
                                        {1020, 10},
                                        {1023, 10},
                                        {1024, 11},
                                        {4080, 12},
                                        {16383, 14},
                                        {16384, 16},
                                        {40000, 16},
                                        {65535, 16}}) {
    images_.clear();
    add(png_of(ramp(brightest)));
    EXPECT_EQ(found().bits, bits) << brightest;
    EXPECT_EQ(found().brightest, brightest);
    EXPECT_FALSE(found().by_chunk);
  }
}

TEST_F(SampleDepthTest, IsLargestNeededByAnyImage) {
  add(png_of(ramp(700)));
  add(png_of(ramp(3000)));
  add(png_of(ramp(90)));
  EXPECT_EQ(found().bits, 12);
  EXPECT_EQ(found().text(), "16-bit images hold 12 bits (brightest value 3000): read as 12-bit");
  add(png_of(ramp(65535)));
  EXPECT_EQ(found().bits, 16);
  EXPECT_FALSE(found().reduced());
}

TEST_F(SampleDepthTest, FollowsChunkWhenValuesFit) {
  add(png_of(ramp(700), {.significant_bits = 12}));
  EXPECT_EQ(found().bits, 12);
  EXPECT_TRUE(found().by_chunk);
  EXPECT_THAT(found().text(), HasSubstr("by their sBIT chunk"));
  // The values are scaled up to 16 bits, as the PNG specification requires of encoders.
  add(png_of(ramp(50000), {.significant_bits = 12}));
  EXPECT_EQ(found().bits, 16);
  images_.clear();
  add(png_of(ramp(9000), {.significant_bits = 12}));
  EXPECT_EQ(found().bits, 16) << "a dark image with scaled values";
}

TEST_F(SampleDepthTest, IgnoresUnreadableFiles) {
  EXPECT_EQ(found().bits, 16) << "without image files the depth is 16";
  add({});
  std::vector<std::uint8_t> damaged = png_of(ramp(300));
  damaged[damaged.size() / 2] ^= 0xFFU;
  add(damaged);
  images_.push_back(folder_.path() / "missing.png");
  images_.push_back(folder_.path());
  EXPECT_EQ(found().bits, 16);
  add(png_of(ramp(1020)));
  EXPECT_EQ(found().bits, 10);
}

// Decoding keeps the upper 8 of the used bits, in every layout. A larger value becomes white.
TEST(DecodeImage, KeepsUpperBitsOfReducedSamples) {
  const Layout layouts[] = {{},
                            {.interlaced = true},
                            {SPNG_COLOR_TYPE_GRAYSCALE_ALPHA, 2, true},
                            {SPNG_COLOR_TYPE_TRUECOLOR, 3},
                            {SPNG_COLOR_TYPE_TRUECOLOR_ALPHA, 4, true, true}};
  for (const Layout& layout : layouts) {
    for (int bits = 8; bits <= 16; ++bits) {
      for (const int brightest : {(1 << bits) - 1, std::min(2 << bits, 65535)}) {
        const Values values = ramp(brightest, layout);
        bool clamped = false;
        const auto frame = decode_image(png_of(values, layout), "a.png", {bits, &clamped});
        ASSERT_TRUE(frame) << frame.error().message;
        const int colours = layout.channels - (layout.alpha ? 1 : 0);
        EXPECT_EQ(frame->format, colours == 1 ? PixelFormat::grey8 : PixelFormat::rgb24);
        EXPECT_EQ(clamped, brightest >= 1 << bits) << bits;
        std::size_t at = 0;
        int wrong = 0;
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x, at += layout.alpha ? 1 : 0) {
            for (int c = 0; c < colours; ++c, ++at) {
              const int got = frame->planes[0].data[y * frame->planes[0].stride + x * colours + c];
              wrong += got != std::min(values[at] >> (bits - 8), 255) ? 1 : 0;
            }
          }
        }
        EXPECT_EQ(wrong, 0) << bits << " bits, brightest " << brightest;
      }
    }
  }
}

TEST(ClampWatch, WarnsOnceOfValuesAboveDepth) {
  ClampWatch watch(10);
  for (const auto& [brightest, warns] : {std::pair{1023, false}, {1024, true}, {4000, false}}) {
    const auto frame = decode_image(png_of(ramp(brightest)), "a.png", watch.options());
    ASSERT_TRUE(frame) << frame.error().message;
    const auto warning = watch.take_warning("a.png");
    EXPECT_EQ(warning.has_value(), warns) << brightest;
    if (warning) {
      EXPECT_THAT(*warning, testing::AllOf(HasSubstr("a.png: "), HasSubstr("10 bits"),
                                           HasSubstr("become white")));
    }
  }
}

TEST(DecodeImage, ReadsDarkImagesLikeEightBitOriginals) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const auto cases = test::shared_dir() / "cases" / "dark-16-bit-pictures";
  for (const auto& [name, bits] : {std::pair{"r_gray10in16", 10}, {"r_gray12in16", 12}}) {
    const std::vector<std::filesystem::path> images = {cases / name / "frames" / "000000.png",
                                                       cases / name / "frames" / "000001.png"};
    const SampleDepth depth = sample_depth_of(images);
    EXPECT_EQ(depth.bits, bits);
    const auto frame = load_image(images[0], {depth.bits});
    ASSERT_TRUE(frame) << frame.error().message;
    std::vector<std::uint8_t> scratch;
    const ImageView grey = luma(*frame, scratch);
    int brightest = 0;
    for (int y = 0; y < grey.height; ++y) {
      brightest =
          std::max<int>(brightest, *std::max_element(grey.row(y), grey.row(y) + grey.width));
    }
    EXPECT_GE(brightest, 250);
  }
}

}  // namespace
}  // namespace penumbra
