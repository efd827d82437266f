// The checks recognise mirrored and negative images of a board. They must not report other images.
#include "tracking/detection/image_check.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <random>
#include <vector>

#include "core/image/frame.hpp"
#include "core/image/image_file.hpp"
#include "support/paths.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

GreyImage view_of(const std::vector<MappedTag>& tags, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  auto renderer = PatternRenderer::create(test::wide_camera(), tags).value();
  PatternRenderOptions options;
  options.samples = 16;
  options.noise_grey = 2.0;
  return renderer.render(std::array{test::random_view(random)}, options);
}

GreyImage mirrored(GreyImage image) {
  for (int y = 0; y < image.height; ++y) {
    const auto row = image.pixels.begin() + std::ptrdiff_t{y} * image.width;
    std::reverse(row, row + image.width);
  }
  return image;
}

GreyImage upside_down(GreyImage image) {
  std::ranges::reverse(image.pixels);
  return image;
}

GreyImage negative(GreyImage image) {
  for (std::uint8_t& value : image.pixels) value = static_cast<std::uint8_t>(255 - value);
  return image;
}

TEST(ImageCheck, RecognisesMirroredAndNegativeImages) {
  const std::vector<MappedTag> tags = test::board(3, 2, 0.06);
  const TagMap map = TagMap::make(tags).value();
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    const GreyImage plain = view_of(tags, seed);
    const auto found = [&](const GreyImage& image) {
      return ImageCheck::create(map).value().check_untagged(image.view());
    };
    EXPECT_EQ(found(mirrored(plain)), ImageFault::mirrored);
    EXPECT_EQ(found(upside_down(mirrored(plain))), ImageFault::mirrored);
    EXPECT_EQ(found(negative(plain)), ImageFault::negative);
    EXPECT_EQ(found(mirrored(negative(plain))), ImageFault::mirrored_negative);
    EXPECT_EQ(found(plain), std::nullopt);
  }
}

TEST(ImageCheck, ReportsNoFaultForImagesOfOtherTags) {
  const std::vector<MappedTag> tags = test::board(3, 2, 0.06);
  std::vector<MappedTag> others = tags;
  for (MappedTag& tag : others) tag.id += 100;
  auto check = ImageCheck::create(TagMap::make(others).value()).value();
  EXPECT_EQ(check.check_untagged(mirrored(view_of(tags, 1)).view()), std::nullopt);
  const std::vector<std::uint8_t> grey(640 * 480, 128);
  EXPECT_EQ(check.check_untagged({grey.data(), 640, 480, 640}), std::nullopt);
  EXPECT_EQ(check.check_untagged({}), std::nullopt);
}

// The check runs on the 1st, 2nd, 4th, 8th ... image and reports a fault once.
TEST(ImageCheck, ChecksFewImagesAndReportsOnce) {
  const std::vector<MappedTag> tags = test::board(3, 2, 0.06);
  const GreyImage fault = mirrored(view_of(tags, 1));
  const std::vector<std::uint8_t> grey(640 * 480, 128);
  const ImageView nothing{grey.data(), 640, 480, 640};
  auto check = ImageCheck::create(TagMap::make(tags).value()).value();
  for (int i = 1; i <= 4; ++i) EXPECT_EQ(check.check_untagged(nothing), std::nullopt);
  for (int i = 5; i <= 7; ++i) EXPECT_EQ(check.check_untagged(fault.view()), std::nullopt) << i;
  EXPECT_EQ(check.check_untagged(fault.view()), ImageFault::mirrored);
  for (int i = 9; i <= 16; ++i) EXPECT_EQ(check.check_untagged(fault.view()), std::nullopt) << i;
}

TEST(ImageCheck, ChecksEveryRequestedImage) {
  const std::vector<MappedTag> tags = test::board(3, 2, 0.06);
  const GreyImage plain = view_of(tags, 1);
  auto check = ImageCheck::create(TagMap::make(tags).value()).value();
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(check.find_fault(mirrored(plain).view()), ImageFault::mirrored);
    EXPECT_EQ(check.find_fault(plain.view()), std::nullopt);
  }
  EXPECT_EQ(check.find_fault({}), std::nullopt);
}

TEST(ImageCheck, RecognisesMirroredAndNegativePhotographs) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const auto cases = test::shared_dir() / "cases" / "mirrored-or-negative-sheet";
  const TagMap map = load_tag_map(test::recordings_dir() / "tabletop" / "tags.yaml").value();
  for (const auto& [name, fault] :
       {std::pair{"mirrored.png", ImageFault::mirrored}, {"inverted.png", ImageFault::negative}}) {
    const Frame frame = load_image(cases / name).value();
    std::vector<std::uint8_t> scratch;
    EXPECT_EQ(ImageCheck::create(map).value().check_untagged(luma(frame, scratch)), fault);
  }
}

}  // namespace
}  // namespace penumbra
