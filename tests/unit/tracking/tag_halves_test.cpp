#include "tracking/evaluation/tag_halves.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <random>
#include <set>

#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

constexpr int kSplits = 4;

std::vector<WeightedTag> weighted(const std::vector<MappedTag>& tags) {
  std::vector<WeightedTag> weighted;
  for (const MappedTag& tag : tags) weighted.push_back({tag.T_table_tag.translation(), 1.0});
  return weighted;
}

// Standard deviation of a half's tags along the weakest direction of the plane.
double spread_of(std::span<const WeightedTag> tags, const std::vector<std::size_t>& half) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const std::size_t i : half) mean += tags[i].position.head<2>();
  mean /= static_cast<double>(half.size());
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
  for (const std::size_t i : half) {
    const Eigen::Vector2d d = tags[i].position.head<2>() - mean;
    scatter += d * d.transpose() / static_cast<double>(half.size());
  }
  return std::sqrt(
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(scatter).eigenvalues().minCoeff());
}

TEST(TagHalves, AreDisjointAndCompleteAndDifferBetweenSplits) {
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  for (std::size_t count = 4; count <= 40; count += 3) {
    std::vector<WeightedTag> tags(count);
    for (WeightedTag& tag : tags) tag.position = {normal(random), normal(random), 0.0};
    const std::vector<TagHalves> splits = balanced_halves(tags, kSplits);
    if (count == 4) {
      EXPECT_THAT(splits.size(), testing::AllOf(testing::Ge(1U), testing::Le(3U)));
    } else {
      EXPECT_EQ(splits.size(), 4U) << count;
    }
    std::set<TagHalves> distinct(splits.begin(), splits.end());
    EXPECT_EQ(distinct.size(), splits.size());
    for (const TagHalves& halves : splits) {
      std::set<std::size_t> all(halves[0].begin(), halves[0].end());
      all.insert(halves[1].begin(), halves[1].end());
      EXPECT_EQ(all.size(), count);
      EXPECT_EQ(halves[0].size() + halves[1].size(), count);
      EXPECT_LE(std::max(halves[0].size(), halves[1].size()),
                std::min(halves[0].size(), halves[1].size()) + 1);
    }
  }
}

TEST(TagHalves, SpanTheWholeSheet) {
  for (const auto& [columns, rows] : {std::pair{4, 3}, {3, 2}, {5, 5}, {14, 11}}) {
    const std::vector<WeightedTag> tags = weighted(test::board(columns, rows, 0.04));
    std::vector<std::size_t> all(tags.size());
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = i;
    // A small sheet has one good split; the others are less balanced.
    double least = 0.7;
    for (const TagHalves& halves : balanced_halves(tags, kSplits)) {
      for (const auto& half : halves)
        EXPECT_GT(spread_of(tags, half), least * spread_of(tags, all)) << columns << " x " << rows;
      if (tags.size() < 12) least = 0.4;
    }
  }
}

TEST(TagHalves, ShareEveryPartOfALargeSheet) {
  // Only a part of a large sheet may be in view. Each window of 4 x 4 tags has tags of both halves.
  constexpr int kColumns = 14, kRows = 11, kWindow = 4;
  const std::vector<WeightedTag> tags = weighted(test::board(kColumns, kRows, 0.03));
  for (const TagHalves& halves : balanced_halves(tags, kSplits)) {
    std::vector<int> half_of(tags.size(), 0);
    for (const std::size_t i : halves[1]) half_of[i] = 1;
    for (int y = 0; y + kWindow <= kRows; ++y) {
      for (int x = 0; x + kWindow <= kColumns; ++x) {
        int second = 0;
        for (int i = 0; i < kWindow * kWindow; ++i)
          second +=
              half_of[static_cast<std::size_t>((y + i / kWindow) * kColumns + x + i % kWindow)];
        EXPECT_GE(second, 4) << x << ", " << y;
        EXPECT_LE(second, 12) << x << ", " << y;
      }
    }
  }
}

TEST(TagHalves, BalanceTheTagsThatAreSeen) {
  // Tags that are hardly ever seen must not decide the balance: the four others are split 2 : 2.
  std::vector<WeightedTag> tags = weighted(test::board(4, 2, 0.04));
  for (const std::size_t rare : {0U, 1U, 2U, 3U}) tags[rare].weight = 0.01;
  const TagHalves first = balanced_halves(tags, kSplits).front();
  EXPECT_EQ(std::ranges::count_if(first[0], [](std::size_t i) { return i >= 4; }), 2);
}

TEST(TagHalves, NeedFourTags) {
  for (int count = 0; count < 4; ++count)
    EXPECT_THAT(balanced_halves(weighted(test::board(std::max(count, 1), count > 0 ? 1 : 0, 0.04)),
                                kSplits),
                testing::IsEmpty());
}

TEST(TagHalves, AreRepeatable) {
  const std::vector<WeightedTag> tags = weighted(test::board(4, 3, 0.04));
  EXPECT_EQ(balanced_halves(tags, kSplits), balanced_halves(tags, kSplits));
}

}  // namespace
}  // namespace penumbra
