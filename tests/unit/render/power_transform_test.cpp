#include "render/shadow/fields/power_transform.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

namespace penumbra {
namespace {

struct Site {
  int column, row;
  float radius;
};

double brute_force(const std::vector<Site>& sites, int column, int row) {
  double smallest = std::numeric_limits<double>::infinity();
  for (const Site& site : sites) {
    const double dx = column - site.column;
    const double dy = row - site.row;
    const double radius = static_cast<double>(site.radius);
    smallest = std::min(smallest, dx * dx + dy * dy - radius * radius);
  }
  return smallest;
}

void expect_as_brute_force(PowerTransform& transform, int width, int height,
                           const std::vector<Site>& sites) {
  transform.start(width, height);
  float largest = 0.0F;
  for (const Site& site : sites) {
    transform.add(site.column, site.row, site.radius);
    largest = std::max(largest, site.radius);
  }
  transform.run();
  // Values are exact in every cell next to a disc's rim, including diagonal neighbours.
  EXPECT_GE(transform.bound(), std::pow(largest + 1.4143F, 2.0F) - largest * largest);
  const double bound = static_cast<double>(transform.bound());
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      const double expected = brute_force(sites, column, row);
      const double actual = static_cast<double>(transform.row(row)[column]);
      if (expected < bound - 0.01) {
        ASSERT_NEAR(actual, expected, 1e-3) << column << " " << row;
      } else if (expected > bound + 0.01) {
        ASSERT_EQ(actual, static_cast<double>(PowerTransform::kFar)) << column << " " << row;
      }
    }
  }
}

TEST(PowerTransform, MatchesBruteForceMinimum) {
  std::mt19937 random(7);
  PowerTransform transform;  // reused, because earlier trials must not affect later ones
  for (const auto& [width, height, count, largest] : {std::tuple{40, 30, 25, 9.0F},
                                                      {17, 61, 5, 60.0F},
                                                      {1, 1, 1, 0.5F},
                                                      {64, 48, 900, 0.6F},
                                                      {33, 5, 3, 2.0F},
                                                      {90, 90, 12, 25.0F}}) {
    std::vector<Site> sites;
    for (int i = 0; i < count; ++i) {
      sites.push_back({std::uniform_int_distribution(0, width - 1)(random),
                       std::uniform_int_distribution(0, height - 1)(random),
                       std::uniform_real_distribution(0.0F, largest)(random)});
    }
    expect_as_brute_force(transform, width, height, sites);
  }
}

TEST(PowerTransform, AcceptsNoSiteAndDiscsLargerThanRaster) {
  PowerTransform transform;
  expect_as_brute_force(transform, 20, 10, {});
  expect_as_brute_force(transform, 20, 10, {{3, 4, 500.0F}});
}

}  // namespace
}  // namespace penumbra
