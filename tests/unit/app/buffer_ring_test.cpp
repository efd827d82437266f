#include "app/capture/v4l2/buffer_ring.hpp"

#include <gtest/gtest.h>

#include <array>
#include <deque>
#include <mutex>
#include <thread>

#include "app/capture/mailbox.hpp"

namespace penumbra {
namespace {

// Fake driver that fills buffers in the order they were queued.
struct FakeDriver {
  std::array<std::array<std::uint8_t, 16>, 4> memory{};
  std::mutex mutex;
  std::deque<unsigned> queued;
  bool refuses = false;
  int released = 0;

  std::shared_ptr<BufferRing> ring() {
    std::vector<std::span<const std::uint8_t>> buffers(memory.begin(), memory.end());
    return BufferRing::create(std::move(buffers), {[this](unsigned index) {
                                                     const std::lock_guard lock(mutex);
                                                     if (refuses) return false;
                                                     queued.push_back(index);
                                                     return true;
                                                   },
                                                   [this] { ++released; }});
  }
  std::optional<unsigned> fill(std::uint8_t value) {
    const std::lock_guard lock(mutex);
    if (queued.empty()) return std::nullopt;
    const unsigned index = queued.front();
    queued.pop_front();
    memory[index].fill(value);
    return index;
  }
};

TEST(BufferRing, ReturnsBufferWhenLastOwnerReleasesIt) {
  FakeDriver driver;
  const auto ring = driver.ring();
  ASSERT_TRUE(ring->queue_all());
  EXPECT_EQ(ring->in_driver(), 4U);
  const auto index = driver.fill(1);
  ASSERT_TRUE(index);
  auto lent = ring->lend(*index);
  auto copy = lent;
  EXPECT_EQ(ring->in_driver(), 3U);
  lent.reset();
  EXPECT_EQ(ring->in_driver(), 3U);
  copy.reset();
  EXPECT_EQ(ring->in_driver(), 4U);
  EXPECT_EQ(driver.queued.back(), *index);
}

TEST(BufferRing, KeepsMemoryAfterCloseUntilLastFrameIsReleased) {
  FakeDriver driver;
  auto ring = driver.ring();
  ASSERT_TRUE(ring->queue_all());
  const unsigned index = driver.fill(7).value();
  auto lent = ring->lend(index);
  ring->close();
  ring.reset();
  EXPECT_EQ(driver.released, 0);
  EXPECT_EQ(static_cast<const std::uint8_t*>(lent.get())[15], 7);
  const std::size_t queued = driver.queued.size();
  lent.reset();
  EXPECT_EQ(driver.queued.size(), queued);  // close() ends the queueing of buffers
  EXPECT_EQ(driver.released, 1);
}

// A weak pointer only identifies an image. It must not keep an unplugged device open, because the
// device would then get another number when it is plugged in again.
TEST(BufferRing, FreesMemoryDespiteWeakPointers) {
  FakeDriver driver;
  auto ring = driver.ring();
  ASSERT_TRUE(ring->queue_all());
  const auto index = driver.fill(1);
  ASSERT_TRUE(index);
  auto lent = ring->lend(*index);
  const std::weak_ptr<const void> seen = lent;
  ring->close();
  ring.reset();
  EXPECT_EQ(driver.released, 0);
  lent.reset();
  EXPECT_EQ(driver.released, 1);
  EXPECT_TRUE(seen.expired());
}

TEST(BufferRing, ReportsBufferThatDriverRefuses) {
  FakeDriver driver;
  const auto ring = driver.ring();
  ASSERT_TRUE(ring->queue_all());
  auto lent = ring->lend(driver.fill(1).value());
  driver.refuses = true;
  EXPECT_FALSE(ring->refused());
  lent.reset();
  EXPECT_TRUE(ring->refused());
  EXPECT_EQ(ring->in_driver(), 3U);
}

TEST(BufferRing, FailsAtOnceWhenDriverRefusesBuffers) {
  FakeDriver driver;
  driver.refuses = true;
  EXPECT_FALSE(driver.ring()->queue_all());
}

// One thread fills buffers, two threads read and release them. A frame must not change while a
// reader holds it.
TEST(BufferRing, KeepsFramesUnchangedAcrossThreads) {
  FakeDriver driver;
  auto ring = driver.ring();
  ASSERT_TRUE(ring->queue_all());
  struct Image {
    std::shared_ptr<const void> owner;
    std::span<const std::uint8_t> bytes;
    std::uint8_t value = 0;
  };
  std::array<Mailbox<Image>, 2> boxes;
  std::thread camera([&] {
    for (int i = 0; i < 4000; ++i) {
      const auto value = static_cast<std::uint8_t>(i);
      const auto index = driver.fill(value);
      if (!index) {
        std::this_thread::yield();
        continue;
      }
      const Image image{ring->lend(*index), ring->buffer(*index), value};
      for (auto& box : boxes) box.put(image);
    }
    ring->close();
    ring.reset();
    for (auto& box : boxes) box.close();
  });
  std::vector<std::thread> readers;
  for (auto& box : boxes) {
    readers.emplace_back([&box] {
      while (!box.finished()) {
        const auto image = box.take(std::chrono::milliseconds(100));
        if (!image) continue;
        for (const std::uint8_t byte : image->bytes) ASSERT_EQ(byte, image->value);
      }
    });
  }
  camera.join();
  for (auto& reader : readers) reader.join();
  EXPECT_EQ(driver.released, 1);
}

}  // namespace
}  // namespace penumbra
