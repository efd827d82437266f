#include "app/capture/mailbox.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <thread>

namespace penumbra {
namespace {

using std::chrono::milliseconds;

TEST(Mailbox, ReturnsNewestItem) {
  Mailbox<int> box;
  box.put(1);
  box.put(2);
  box.put(3);
  EXPECT_EQ(box.take(milliseconds(0)), 3);
  EXPECT_EQ(box.take(milliseconds(0)), std::nullopt);
}

TEST(Mailbox, ReleasesDroppedItemAtOnce) {
  Mailbox<std::shared_ptr<int>> box;
  const auto first = std::make_shared<int>(1);
  box.put(first);
  EXPECT_EQ(first.use_count(), 2);
  box.put(std::make_shared<int>(2));
  EXPECT_EQ(first.use_count(), 1);
}

TEST(Mailbox, KeepsLastItemAfterCloseAndAcceptsNoMore) {
  Mailbox<int> box;
  box.put(1);
  box.close();
  box.put(2);
  EXPECT_FALSE(box.put_when_empty(3));
  EXPECT_FALSE(box.finished());
  EXPECT_EQ(box.take(milliseconds(0)), 1);
  EXPECT_TRUE(box.finished());
  // take() returns at once, because no further value can come.
  EXPECT_EQ(box.take(std::chrono::hours(1)), std::nullopt);
}

TEST(Mailbox, DeliversItemsOfPutWhenEmptyInOrder) {
  Mailbox<int> box;
  std::thread producer([&] {
    for (int i = 0; i < 1000; ++i) ASSERT_TRUE(box.put_when_empty(i));
    box.close();
  });
  int expected = 0;
  while (!box.finished()) {
    if (const auto item = box.take(milliseconds(100))) {
      ASSERT_EQ(*item, expected++);
    }
  }
  producer.join();
  EXPECT_EQ(expected, 1000);
}

TEST(Mailbox, KeepsOrderBetweenThreads) {
  Mailbox<std::unique_ptr<int>> box;
  constexpr int kItems = 20000;
  std::thread producer([&] {
    for (int i = 0; i < kItems; ++i) box.put(std::make_unique<int>(i));
    box.close();
  });
  int last = -1;
  while (!box.finished()) {
    const auto item = box.take(milliseconds(100));
    if (!item) continue;
    ASSERT_GT(**item, last);
    last = **item;
  }
  producer.join();
  EXPECT_EQ(last, kItems - 1);
}

TEST(Mailbox, LetsProducerWaitForEmptySlot) {
  Mailbox<int> box;
  EXPECT_TRUE(box.wait_until_empty());
  box.put(1);
  std::atomic<bool> taken = false;
  std::thread producer([&] {
    EXPECT_TRUE(box.wait_until_empty());
    EXPECT_TRUE(taken);
  });
  std::this_thread::sleep_for(milliseconds(20));
  taken = true;
  EXPECT_EQ(box.take(milliseconds(0)), 1);
  producer.join();
  box.put(2);
  std::thread waiting([&] { EXPECT_FALSE(box.wait_until_empty()); });
  box.close();
  waiting.join();
}

TEST(Mailbox, WakesWaitingProducerOnClose) {
  Mailbox<int> box;
  box.put(1);
  std::thread producer([&] { EXPECT_FALSE(box.put_when_empty(2)); });
  box.close();
  producer.join();
}

}  // namespace
}  // namespace penumbra
