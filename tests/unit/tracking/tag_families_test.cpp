// ArUco dictionaries as tag families.
#include "tracking/detection/tag_families.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <bit>

#include "support/synthetic_board.hpp"
#include "tracking/alignment/tag_pattern.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {
namespace {

// Returns the code of the marker rotated by 90 degrees; cells are in row-major order.
std::uint64_t turned(std::uint64_t code, int cells) {
  std::uint64_t result = 0;
  for (int row = 0; row < cells; ++row) {
    for (int column = 0; column < cells; ++column) {
      const int from = (cells - 1 - column) * cells + row;
      result = result << 1U | (code >> (cells * cells - 1 - from) & 1U);
    }
  }
  return result;
}

TEST(ArucoCodes, HaveHammingDistanceForErrorCorrection) {
  for (int number = static_cast<int>(TagFamily::aruco_4x4_50);
       number <= static_cast<int>(TagFamily::aruco_6x6_1000); ++number) {
    const auto family = static_cast<TagFamily>(number);
    const auto dictionary = aruco_dictionary_of(family);
    ASSERT_TRUE(dictionary);
    const auto codes = aruco_codes(dictionary->cells, dictionary->count);
    ASSERT_EQ(codes.size(), static_cast<std::size_t>(dictionary->count));
    int nearest = 64;
    for (std::size_t i = 0; i < codes.size(); ++i) {
      std::uint64_t code = codes[i];
      for (int turn = 0; turn < 4; ++turn) {
        for (std::size_t j = turn == 0 ? i + 1 : i; j < codes.size(); ++j)
          nearest = std::min(nearest, std::popcount(code ^ codes[j]));
        code = turned(code, dictionary->cells);
      }
      ASSERT_EQ(code, codes[i]);
    }
    EXPECT_GE((nearest - 1) / 2, max_corrected_bits(family)) << to_string(family);
  }
}

// Compares with the first marker in OpenCV's documentation: rows from the top, 1 is white.
TEST(ArucoCodes, AreOrientedLikeOpenCv) {
  const auto pattern = TagPattern::make(TagFamily::aruco_4x4_50, 0);
  ASSERT_TRUE(pattern);
  ASSERT_EQ(pattern->total_width(), 8);
  const std::array<const char*, 4> rows = {"1011", "0101", "0011", "0010"};
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      EXPECT_EQ(pattern->white(2 + column, 5 - row), rows[row][column] == '1')
          << row << ' ' << column;
    }
  }
}

TEST(ArucoCodes, AreDetected) {
  const std::array families = {TagFamily::aruco_4x4_50, TagFamily::aruco_5x5_100,
                               TagFamily::aruco_6x6_250};
  for (const TagFamily family : families) {
    std::vector<MappedTag> tags = test::board(4, 3, 0.04);
    for (MappedTag& tag : tags) tag.family = family;
    auto renderer = PatternRenderer::create(test::wide_camera(), tags);
    ASSERT_TRUE(renderer);
    PatternRenderOptions options;
    options.samples = 32;
    options.noise_grey = 1.0;
    const auto pose =
        test::looking_at(Eigen::Vector3d::Zero(), 0.4, radians(60.0), radians(30.0), radians(20.0));
    const GreyImage image = renderer->render(std::array{pose}, options);
    auto detector = TagDetector::create(std::array{family});
    ASSERT_TRUE(detector);
    const auto found = detector->detect(image.view());
    // A single square inside a marker may happen to be a valid marker.
    EXPECT_LE(found.size(), tags.size() + 1) << to_string(family);
    const auto T_camera_table = pose.inverse();
    for (const MappedTag& tag : tags) {
      const auto corners = tag.corners();
      const auto is_there = [&](const TagDetection& detection) {
        if (detection.id != tag.id) return false;
        for (std::size_t c = 0; c < 4; ++c) {
          const auto expected = test::wide_camera().project(T_camera_table * corners[c]);
          if (!((detection.corners_px[c] - *expected).norm() < 0.7)) return false;
        }
        return true;
      };
      EXPECT_EQ(std::count_if(found.begin(), found.end(), is_there), 1)
          << to_string(family) << ' ' << tag.id;
    }
  }
}

}  // namespace
}  // namespace penumbra
