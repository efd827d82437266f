#include "app/output/background_writer.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <stdexcept>
#include <thread>

namespace penumbra {
namespace {

struct Log {
  std::vector<std::uint64_t> numbers;
  std::vector<std::uint8_t> first_bytes;
  int finished = 0;
  std::atomic<int> done = 0;
};

// Slow writer that returns an error, or throws, at frame `failing_number`.
class SlowWriter final : public FrameWriter {
 public:
  SlowWriter(Log& log, std::uint64_t failing_number, bool throws)
      : log_(log), failing_number_(failing_number), throws_(throws) {}
  Result<void> write(std::uint64_t number, std::int64_t,
                     std::span<const std::uint8_t> rgba) override {
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
    if (number == failing_number_) {
      if (throws_) throw std::runtime_error("disk gone");
      return fail("disk full");
    }
    log_.numbers.push_back(number);
    log_.first_bytes.push_back(rgba[0]);
    ++log_.done;
    return {};
  }
  Result<void> finish() override {
    ++log_.finished;
    return {};
  }

 private:
  Log& log_;
  const std::uint64_t failing_number_;
  const bool throws_;
};

constexpr std::uint64_t kNoFailure = 1'000'000;

BackgroundWriter slow_writer(Log& log, int depth, std::uint64_t failing_number = kNoFailure,
                             bool throws = false) {
  return BackgroundWriter(std::make_unique<SlowWriter>(log, failing_number, throws), depth);
}

class BackgroundWriterQueue : public testing::TestWithParam<int> {};

TEST_P(BackgroundWriterQueue, WritesFramesInOrderWithTheirPixels) {
  Log log;
  auto writer = slow_writer(log, GetParam());
  std::vector<std::uint8_t> pixels(16);
  for (std::uint64_t i = 0; i < 40; ++i) {
    pixels[0] = static_cast<std::uint8_t>(i);
    ASSERT_TRUE(writer.write(i, 0, pixels));
    // The queue copies the image, so the caller may overwrite it at once. The queue's length is
    // bounded.
    pixels[0] = 255;
    EXPECT_LE(static_cast<int>(i) + 1 - log.done, GetParam() + 2);
  }
  ASSERT_TRUE(writer.finish());
  ASSERT_EQ(log.numbers.size(), 40U);
  for (std::size_t i = 0; i < 40; ++i) {
    EXPECT_EQ(log.numbers[i], i);
    EXPECT_EQ(log.first_bytes[i], i);
  }
  EXPECT_EQ(log.finished, 1);
  EXPECT_EQ(writer.take_times().size(), 40U);
  EXPECT_TRUE(writer.take_times().empty()) << "each time is returned once";
}

TEST_P(BackgroundWriterQueue, ReportsFirstErrorAndDoesNotFinish) {
  for (const bool throws : {false, true}) {
    if (throws && GetParam() == 0) continue;  // without a queue, the exception reaches the caller
    Log log;
    auto writer = slow_writer(log, GetParam(), 5, throws);
    const std::vector<std::uint8_t> pixels(16);
    Result<void> result;
    std::uint64_t written = 0;
    for (; written < 100 && result; ++written) result = writer.write(written, 0, pixels);
    EXPECT_LT(written, 100U) << "a failed encoder gets no further frames";
    if (GetParam() > 0) result = writer.finish();
    ASSERT_FALSE(result);
    EXPECT_EQ(result.error().message, throws ? "disk gone" : "disk full");
    EXPECT_EQ(log.numbers.size(), 5U) << "nothing is written after the frame that failed";
    EXPECT_EQ(log.finished, 0);
  }
}

TEST_P(BackgroundWriterQueue, StopsWithoutFinishingWhenDestroyed) {
  Log log;
  {
    auto writer = slow_writer(log, GetParam());
    const std::vector<std::uint8_t> pixels(16);
    for (std::uint64_t i = 0; i < 4; ++i) ASSERT_TRUE(writer.write(i, 0, pixels));
  }
  EXPECT_EQ(log.finished, 0);
}

INSTANTIATE_TEST_SUITE_P(Depths, BackgroundWriterQueue, testing::Values(0, 1, 4),
                         [](const auto& test) { return "Depth" + std::to_string(test.param); });

}  // namespace
}  // namespace penumbra
