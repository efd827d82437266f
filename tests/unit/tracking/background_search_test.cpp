#include "tracking/detection/background_search.hpp"

#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <thread>

#include "support/group_stage.hpp"

namespace penumbra {
namespace background_search_test {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::array kFamilies = {TagFamily::tag36h11};

std::unique_ptr<BackgroundSearch> search(bool own_thread) {
  return BackgroundSearch::create(kFamilies, 1.6, own_thread).value();
}

void expect_same(const std::vector<TagDetection>& a, const std::vector<TagDetection>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].id, b[i].id);
    EXPECT_EQ(a[i].corners_px, b[i].corners_px);
  }
}

// The background search must find the same tags as the immediate search, even if the caller
// overwrites the pixels during the search.
TEST(BackgroundSearch, FindsSameTagsAsImmediateSearch) {
  const test::Stage stage({test::wall()});
  for (const bool own_thread : {false, true}) {
    SCOPED_TRACE(own_thread);
    auto beside = search(own_thread);
    EXPECT_TRUE(beside->idle());
    EXPECT_FALSE(beside->take(true));
    TagSearch at_once = TagSearch::create(kFamilies, 1.6).value();
    for (int f = 0; f < 4; ++f) {
      const Frame frame = stage.frame_image(f);
      std::vector<std::uint8_t> scratch;
      const ImageView image = luma(frame, scratch);
      const auto resolution = f % 2 == 0 ? SearchResolution::half : SearchResolution::full;
      std::vector<std::uint8_t> copy(static_cast<std::size_t>(image.width) *
                                     static_cast<std::size_t>(image.height));
      for (int y = 0; y < image.height; ++y) {
        std::copy_n(image.row(y), image.width,
                    copy.begin() + static_cast<std::ptrdiff_t>(y) * image.width);
      }
      beside->begin({copy.data(), image.width, image.height, image.width}, 1000 + f, resolution);
      EXPECT_FALSE(beside->idle());
      std::fill(copy.begin(), copy.end(), std::uint8_t{0});
      const auto found = beside->take(true);
      ASSERT_TRUE(found);
      EXPECT_TRUE(beside->idle());
      EXPECT_EQ(found->timestamp_ns, 1000 + f);
      EXPECT_GT(found->time.wall_ms, 0.0);
      at_once.begin(frame);
      EXPECT_GE(found->tags.size(), 6U);
      expect_same(found->tags, at_once.tags(resolution));
    }
  }
}

TEST(BackgroundSearch, NeverBlocksCaller) {
  const test::Stage stage({test::wall()});
  const Frame frame = stage.frame_image(0);
  std::vector<std::uint8_t> scratch;
  const ImageView image = luma(frame, scratch);
  auto beside = search(true);
  beside->begin(image, 7, SearchResolution::full);
  const auto end = Clock::now() + std::chrono::seconds(30);
  std::optional<PastTags> found;
  while (!found && Clock::now() < end) {
    found = beside->take(false);
    if (!found) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  ASSERT_TRUE(found);
  EXPECT_GE(found->tags.size(), 6U);
  // The destructor must handle a running search, and a result that the caller has not read.
  beside->begin(image, 8, SearchResolution::full);
  beside.reset();
  beside = search(true);
  beside->begin(image, 9, SearchResolution::half);
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
}

}  // namespace
}  // namespace background_search_test
}  // namespace penumbra
