// Layout of panes side by side, with captions outside the panes.
#include "app/output/pane_grid.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>

namespace penumbra {
namespace {

TEST(PaneGrid, ChoosesColumnsByPaneCount) {
  const std::map<int, GridLayout> expected = {{1, {1, 1}}, {2, {2, 1}}, {3, {3, 1}}, {4, {2, 2}},
                                              {5, {3, 2}}, {6, {3, 2}}, {7, {4, 2}}, {8, {4, 2}}};
  for (const auto& [panes, layout] : expected) EXPECT_EQ(grid_layout(panes), layout) << panes;
}

std::vector<std::uint8_t> plain(int width, int height, std::uint8_t value) {
  return std::vector<std::uint8_t>(
      std::size_t{4} * static_cast<std::size_t>(width) * static_cast<std::size_t>(height), value);
}

class PaneGridLayout : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Panes, PaneGridLayout, testing::Values(2, 3, 4, 5, 6, 7, 8),
                         [](const auto& test) { return "Panes" + std::to_string(test.param); });

TEST_P(PaneGridLayout, WritesOnlyPixelsOfEachPane) {
  constexpr int kWidth = 61;
  constexpr int kHeight = 47;
  const auto panes = static_cast<std::size_t>(GetParam());
  std::vector<std::string> captions;
  for (std::size_t i = 0; i < panes; ++i) captions.push_back("pane " + std::to_string(i));
  PaneGrid grid(kWidth, kHeight, captions);
  EXPECT_EQ(grid.width() % 2, 0);
  EXPECT_EQ(grid.height() % 2, 0);
  const GridSize size = grid_size(kWidth, kHeight, GetParam());
  EXPECT_EQ(grid.width(), size.width);
  EXPECT_EQ(grid.height(), size.height);
  const std::vector<std::uint8_t> empty(grid.rgba().begin(), grid.rgba().end());
  for (std::size_t i = 0; i < panes; ++i) {
    grid.put(i, plain(kWidth, kHeight, static_cast<std::uint8_t>(100 + i)));
  }
  std::vector<int> seen(panes, 0);
  for (int y = 0; y < grid.height(); ++y) {
    for (int x = 0; x < grid.width(); ++x) {
      const auto at =
          std::size_t{4} * (static_cast<std::size_t>(y) * static_cast<std::size_t>(grid.width()) +
                            static_cast<std::size_t>(x));
      std::size_t pane = panes;
      for (std::size_t i = 0; i < panes; ++i) {
        const PaneGrid::Corner corner = grid.corner_of(i);
        if (x >= corner.x && x < corner.x + kWidth && y >= corner.y && y < corner.y + kHeight) {
          ASSERT_EQ(pane, panes) << "two panes at " << x << ", " << y;
          pane = i;
        }
      }
      if (pane < panes) {
        ASSERT_EQ(grid.rgba()[at], 100 + pane) << x << ", " << y;
        ++seen[pane];
      } else {
        ASSERT_EQ(grid.rgba()[at], empty[at]) << x << ", " << y;
      }
    }
  }
  EXPECT_EQ(seen, std::vector<int>(panes, kWidth * kHeight));
}

// Brightest value of each column in the caption's band above a pane.
std::vector<int> caption_of(const PaneGrid& grid, std::size_t pane, int pane_width, int band) {
  std::vector<int> brightest;
  const PaneGrid::Corner corner = grid.corner_of(pane);
  for (int x = corner.x; x < corner.x + pane_width; ++x) {
    int maximum = 0;
    for (int y = corner.y - band; y < corner.y; ++y) {
      maximum = std::max<int>(
          maximum, grid.rgba()[std::size_t{4} * (static_cast<std::size_t>(y) *
                                                     static_cast<std::size_t>(grid.width()) +
                                                 static_cast<std::size_t>(x))]);
    }
    brightest.push_back(maximum);
  }
  return brightest;
}

TEST(PaneGrid, DrawsReadableCaptionsThatFit) {
  constexpr int kWidth = 320;
  constexpr int kBand = 20;
  const PaneGrid grid(
      kWidth, 240, {"layered", "", "a caption of so many words that its letters must be smaller"});
  const auto of = [&](std::size_t pane) { return caption_of(grid, pane, kWidth, kBand); };
  const auto inked = [](const std::vector<int>& band) {
    return std::ranges::count_if(band, [](int value) { return value > 180; });
  };
  EXPECT_GT(inked(of(0)), 20) << "the letters must be nearly white";
  EXPECT_EQ(inked(of(1)), 0);
  const std::vector<int> longest = of(2);
  EXPECT_GT(inked(longest), 100);
  EXPECT_LT(longest.front(), 60) << "the caption must fit the pane";
  EXPECT_LT(longest.back(), 60);
}

}  // namespace
}  // namespace penumbra
