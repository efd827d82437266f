#include "app/recording/look_ahead.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <stdexcept>
#include <thread>

namespace penumbra {
namespace {

using Numbers = LookAhead<int>;

class LookAheadDepth : public testing::TestWithParam<int> {};

TEST_P(LookAheadDepth, DeliversItemsInOrderAndStaysAtEnd) {
  int made = 0;
  Numbers numbers(
      [&]() -> Numbers::Item {
        if (made == 1000) return std::optional<int>();
        return std::optional<int>(made++);
      },
      GetParam());
  for (int i = 0; i < 1000; ++i) {
    const auto item = numbers.next();
    ASSERT_TRUE(item);
    ASSERT_EQ(*item, std::optional<int>(i));
  }
  for (int i = 0; i < 3; ++i) {
    const auto end = numbers.next();
    ASSERT_TRUE(end);
    EXPECT_FALSE(end->has_value());
  }
}

TEST_P(LookAheadDepth, DeliversErrorInOrderAndRepeatsIt) {
  int made = 0;
  Numbers numbers(
      [&]() -> Numbers::Item {
        if (made == 3) return fail("frame 3 is broken");
        return std::optional<int>(made++);
      },
      GetParam());
  for (int i = 0; i < 3; ++i) ASSERT_EQ(*numbers.next(), std::optional<int>(i));
  for (int i = 0; i < 2; ++i) {
    const auto item = numbers.next();
    ASSERT_FALSE(item);
    EXPECT_EQ(item.error().message, "frame 3 is broken");
  }
  EXPECT_EQ(made, 3);
}

TEST_P(LookAheadDepth, ConvertsExceptionToError) {
  Numbers numbers([]() -> Numbers::Item { throw std::runtime_error("thrown"); }, GetParam());
  const auto item = numbers.next();
  ASSERT_FALSE(item);
  EXPECT_EQ(item.error().message, "thrown");
}

INSTANTIATE_TEST_SUITE_P(All, LookAheadDepth, testing::Values(0, 1, 2, 7),
                         [](const auto& test) { return "Depth" + std::to_string(test.param); });

TEST(LookAhead, NeverProducesMoreThanDepthAhead) {
  std::atomic<int> made = 0;
  std::atomic<int> taken = 0;
  std::atomic<int> max_ahead = 0;
  {
    Numbers numbers(
        [&]() -> Numbers::Item {
          // One item is being made while at most 3 wait. `taken` does not yet count the item that
          // was just returned.
          max_ahead = std::max(max_ahead.load(), made.load() + 1 - taken.load());
          return std::optional<int>(made++);
        },
        3);
    for (int i = 0; i < 500; ++i) {
      ASSERT_EQ(*numbers.next(), std::optional<int>(i));
      ++taken;
    }
  }
  EXPECT_LE(max_ahead.load(), 3 + 1);
}

TEST(LookAhead, JoinsThreadAndFreesItemsWhenDestroyedEarly) {
  const auto counted = std::make_shared<int>(7);
  for (int round = 0; round < 200; ++round) {
    LookAhead<std::shared_ptr<int>> items(
        [&]() -> LookAhead<std::shared_ptr<int>>::Item { return std::optional(counted); }, 4);
    for (int i = 0; i < round % 5; ++i) ASSERT_TRUE(items.next());
  }
  EXPECT_EQ(counted.use_count(), 1);
}

TEST(LookAhead, ProducesAheadOfConsumer) {
  std::atomic<int> made = 0;
  Numbers numbers([&]() -> Numbers::Item { return std::optional<int>(made++); }, 4);
  while (made.load() < 4)
    std::this_thread::yield();  // items are produced before the first call of next()
  EXPECT_EQ(*numbers.next(), std::optional<int>(0));
}

}  // namespace
}  // namespace penumbra
