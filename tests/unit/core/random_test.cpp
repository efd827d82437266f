#include "core/random.hpp"

#include <gtest/gtest.h>

#include <array>
#include <set>

namespace penumbra {
namespace {

// The first numbers of the published generator for the seed 1234567.
TEST(SplitMix64, ReproducesPublishedSequence) {
  constexpr std::array<std::uint64_t, 5> kExpected = {6457827717110365317U, 3203168211198807973U,
                                                      9817491932198370423U, 4593380528125082431U,
                                                      16408922859458223821U};
  SplitMix64 random(1234567);
  for (std::uint64_t n = 0; n < kExpected.size(); ++n) {
    EXPECT_EQ(random.next(), kExpected[n]) << n;
    EXPECT_EQ(SplitMix64::nth(1234567, n), kExpected[n]) << n;
  }
}

TEST(SplitMix64, StaysInRangeAndSeparatesStreams) {
  SplitMix64 random(7);
  std::set<std::size_t> seen;
  for (int i = 0; i < 1000; ++i) {
    const double x = random.between(-2.0, 3.0);
    EXPECT_GE(x, -2.0);
    EXPECT_LT(x, 3.0);
    seen.insert(random.below(5));
  }
  EXPECT_EQ(seen, (std::set<std::size_t>{0, 1, 2, 3, 4}));
  EXPECT_NE(SplitMix64(7, 1).next(), SplitMix64(7, 2).next());
  EXPECT_NE(SplitMix64(7, 1).next(), SplitMix64(8, 1).next());
}

}  // namespace
}  // namespace penumbra
