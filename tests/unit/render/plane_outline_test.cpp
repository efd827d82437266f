// Positions and lines inside a plane's outline.
#include "render/scene/plane_outline.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <random>

namespace penumbra {
namespace {

using Outline = std::vector<Eigen::Vector2d>;

// A star-shaped polygon, concave for most random radii.
Outline random_outline(std::mt19937& random) {
  std::uniform_real_distribution<double> radius(0.1, 1.0);
  const int corners = 3 + static_cast<int>(random() % 9);
  Outline outline;
  for (int i = 0; i < corners; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / corners;
    outline.push_back(radius(random) * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
  }
  return outline;
}

TEST(PlaneOutline, SplitsLinesWhereTheyEnterAndLeave) {
  // A U of which a horizontal line crosses both arms.
  const Outline u = {{0, 0}, {3, 0}, {3, 2}, {2, 2}, {2, 1}, {1, 1}, {1, 2}, {0, 2}};
  const std::vector<PlaneLine> parts = parts_inside({{4, 1.5}, {-1, 1.5}}, u);
  ASSERT_EQ(parts.size(), 2U);
  EXPECT_TRUE(parts[0].from.isApprox(Eigen::Vector2d(3, 1.5)));
  EXPECT_TRUE(parts[0].to.isApprox(Eigen::Vector2d(2, 1.5)));
  EXPECT_TRUE(parts[1].from.isApprox(Eigen::Vector2d(1, 1.5)));
  EXPECT_LT((parts[1].to - Eigen::Vector2d(0, 1.5)).norm(), 1e-15);
  EXPECT_TRUE(parts_inside({{4, 5}, {-1, 5}}, u).empty());
  const std::vector<PlaneLine> within = parts_inside({{0.1, 0.2}, {2.9, 0.7}}, u);
  ASSERT_EQ(within.size(), 1U);
  EXPECT_EQ(within[0].from, Eigen::Vector2d(0.1, 0.2));
  EXPECT_EQ(within[0].to, Eigen::Vector2d(2.9, 0.7));
}

// Compares the parts with the positions along the line.
TEST(PlaneOutline, KeepsExactlyThePositionsInside) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> place(-1.2, 1.2);
  int inside = 0;
  int outside = 0;
  for (int n = 0; n < 5000; ++n) {
    const Outline outline = random_outline(random);
    const PlaneLine line{{place(random), place(random)}, {place(random), place(random)}};
    const Eigen::Vector2d along = line.to - line.from;
    const std::vector<PlaneLine> parts = parts_inside(line, outline);
    for (int k = 0; k < 40; ++k) {
      const double t = (k + 0.5) / 40;
      bool in_part = false;
      bool near_end = false;
      for (const PlaneLine& part : parts) {
        const double from = (part.from - line.from).dot(along) / along.squaredNorm();
        const double to = (part.to - line.from).dot(along) / along.squaredNorm();
        ASSERT_LT(from, to);
        in_part = in_part || (t > from && t < to);
        near_end = near_end || std::abs(t - from) < 1e-9 || std::abs(t - to) < 1e-9;
      }
      const bool is_in = is_inside(line.from + t * along, outline);
      ASSERT_TRUE(near_end || in_part == is_in) << n << ", " << t;
      (is_in ? inside : outside) += 1;
    }
  }
  EXPECT_GT(inside, 20'000);
  EXPECT_GT(outside, 20'000);
}

// Through a corner, from outside and from inside.
TEST(PlaneOutline, CrossesCornersOnce) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> place(-1.0, 1.0);
  for (int n = 0; n < 20'000; ++n) {
    const double w = 0.1 + std::abs(place(random));
    const double h = 0.1 + std::abs(place(random));
    const Outline rectangle = {{0, 0}, {w, 0}, {w, h}, {0, h}};
    const Eigen::Vector2d centre(0.5 * w, 0.5 * h);
    const Eigen::Vector2d corner = rectangle[random() % 4];
    const Eigen::Vector2d beyond = corner + 0.7 * (corner - centre);
    const auto out = parts_inside({centre, beyond}, rectangle);
    const auto in = parts_inside({beyond, centre}, rectangle);
    ASSERT_EQ(out.size(), 1U) << n;
    ASSERT_EQ(in.size(), 1U) << n;
    ASSERT_LT((out[0].to - corner).norm(), 1e-12) << n;
    ASSERT_LT((in[0].from - corner).norm(), 1e-12) << n;
  }
}

TEST(PlaneOutline, AcceptsEmptyOutlinesPointsAndNonFiniteLines) {
  const Outline square = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  EXPECT_FALSE(is_inside({0.5, 0.5}, {}));
  EXPECT_TRUE(parts_inside({{0, 0}, {1, 1}}, {}).empty());
  EXPECT_EQ(parts_inside({{0.5, 0.5}, {0.5, 0.5}}, square).size(), 1U);
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), 1e300}) {
    for (const PlaneLine& part : parts_inside({{0.5, 0.5}, {bad, bad}}, square)) {
      EXPECT_TRUE(part.from.allFinite() && part.to.allFinite()) << bad;
    }
  }
}

}  // namespace
}  // namespace penumbra
