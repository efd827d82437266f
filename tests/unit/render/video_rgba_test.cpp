#include "render/scene/video_rgba.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <random>
#include <vector>

#include "render/edges/video_pixels.hpp"

namespace penumbra {
namespace {

// Fills every plane, the bytes beyond an odd width too.
Frame random_frame(PixelFormat format, int width, int height, std::mt19937& random) {
  FrameBuffer buffer = allocate_frame(format, width, height);
  for (std::size_t i = 0; i < static_cast<std::size_t>(buffer.frame.plane_count); ++i) {
    const PixelPlane& plane = buffer.frame.planes[i];
    std::generate_n(buffer.plane_data[i], plane.stride * plane.height,
                    [&random] { return static_cast<std::uint8_t>(random()); });
  }
  return buffer.frame;
}

constexpr auto kFormats = {PixelFormat::grey8,  PixelFormat::rgb24,   PixelFormat::yuyv,
                           PixelFormat::nv12,   PixelFormat::yuv420p, PixelFormat::yuv422p,
                           PixelFormat::yuv444p};

// Compares with the exact conversion of single pixels, in all formats, matrices and ranges, and at
// sizes that are odd or below a vector's length.
TEST(VideoRgba, IsWithinOneCodeOfExactConversion) {
  std::mt19937 random(40);
  VideoRgba video;
  for (const PixelFormat format : kFormats) {
    std::int64_t compared = 0;
    std::int64_t different = 0;
    for (const ColorMatrix matrix : {ColorMatrix::bt601, ColorMatrix::bt709}) {
      for (const ColorRange range : {ColorRange::full, ColorRange::limited}) {
        for (const auto& [width, height] :
             {std::pair(1, 1), {2, 2}, {3, 5}, {17, 4}, {64, 33}, {161, 91}, {320, 40}}) {
          Frame frame = random_frame(format, width, height, random);
          frame.color_matrix = matrix;
          frame.color_range = range;
          const auto rgba = video.convert(frame);
          ASSERT_EQ(rgba.size(), std::size_t{4} * static_cast<std::size_t>(width * height));
          const VideoPixels exact(frame);
          for (int y = 0; y < height; ++y) {
            for (int x = 0; x < width; ++x) {
              const glm::vec3 expected = glm::clamp(exact.at(x, y), 0.0F, 255.0F);
              const auto at = static_cast<std::size_t>(4 * (y * width + x));
              for (int c = 0; c < 3; ++c) {
                const int code = rgba[at + static_cast<std::size_t>(c)];
                const int rounded = static_cast<int>(std::lround(expected[c]));
                ASSERT_LE(std::abs(code - rounded), 1)
                    << static_cast<int>(format) << " at " << x << ' ' << y << ", channel " << c;
                ++compared;
                different += code != rounded ? 1 : 0;
              }
              ASSERT_EQ(rgba[at + 3], 255);
            }
          }
        }
      }
    }
    // Only values near the middle between two codes may round the other way.
    EXPECT_LE(static_cast<double>(different), 0.03 * static_cast<double>(compared))
        << static_cast<int>(format);
  }
}

// Rows may be padded or in reverse order, and the next frame may have another size and format.
TEST(VideoRgba, ReadsRowsAtAnyDistance) {
  std::mt19937 random(43);
  VideoRgba video;
  for (const PixelFormat format : kFormats) {
    for (const int gap : {0, 1, 5, 64}) {
      const Frame frame = random_frame(format, 20 + gap, 10, random);
      const auto rgba = video.convert(frame);
      const std::vector<std::uint8_t> expected(rgba.begin(), rgba.end());
      Frame padded = frame;
      std::array<std::vector<std::uint8_t>, 3> planes;
      for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
        PixelPlane& plane = padded.planes[i];
        const std::ptrdiff_t stride = plane.stride + gap;
        planes[i].resize(static_cast<std::size_t>(stride * plane.height));
        // The last row comes first in memory.
        for (int y = 0; y < plane.height; ++y)
          std::copy_n(plane.data + y * plane.stride, plane.stride,
                      planes[i].data() + (plane.height - 1 - y) * stride);
        plane.data = planes[i].data() + (plane.height - 1) * stride;
        plane.stride = -stride;
      }
      const auto again = video.convert(padded);
      EXPECT_TRUE(std::ranges::equal(again, expected)) << static_cast<int>(format) << " " << gap;
    }
  }
}

TEST(VideoRgba, KnowsFrameThatItHolds) {
  std::mt19937 random(41);
  VideoRgba video;
  Frame first = random_frame(PixelFormat::nv12, 16, 8, random);
  const Frame second = random_frame(PixelFormat::nv12, 16, 8, random);
  EXPECT_FALSE(video.holds(first));
  (void)video.convert(first);
  EXPECT_TRUE(video.holds(first));
  EXPECT_FALSE(video.holds(second));
  (void)video.convert(second);
  EXPECT_FALSE(video.holds(first));
  Frame copy = second;
  EXPECT_TRUE(video.holds(copy)) << "a copy shares the pixels";
  copy.owner.reset();
  EXPECT_FALSE(video.holds(copy)) << "pixels without an owner may change";
  (void)video.convert(copy);
  EXPECT_FALSE(video.holds(copy));
}

}  // namespace
}  // namespace penumbra
