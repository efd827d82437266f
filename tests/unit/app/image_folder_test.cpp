// Folders of images to calibrate from.
#include "app/calibration/image_folder.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

#include "core/text/text.hpp"
#include "support/deep_png.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

// The sample depth is determined from 256 of the 300 images. The seventh image is not one of them.
TEST(ImageSource, WarnsOfValuesAboveBitDepthOfOtherImages) {
  const test::TemporaryFolder folder;
  constexpr int kCount = 300;
  constexpr int kSkipped = 6;
  const auto name_of = [](int i) { return fmt::format("{:03}.png", i); };
  for (int i = 0; i < kCount; ++i) {
    const std::uint16_t brightest = i == kSkipped ? 4000 : 1000;
    const auto bytes = test::deep_png({0, 100, 500, brightest}, 2, 2);
    ASSERT_TRUE(write_file(folder.path() / name_of(i), bytes));
  }
  std::vector<std::string> notices;
  int images = 0;
  const auto read = for_each_image(folder.path(), [&](const NamedImage& image) -> Result<bool> {
    ++images;
    notices.insert(notices.end(), image.notices.begin(), image.notices.end());
    return true;
  });
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(images, kCount);
  EXPECT_THAT(notices, ElementsAre(HasSubstr("read as 10-bit"),
                                   AllOf(HasSubstr(name_of(kSkipped)), HasSubstr("become white"))));
}

}  // namespace
}  // namespace penumbra
