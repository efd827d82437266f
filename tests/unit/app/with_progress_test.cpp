// The progress bar of long tasks, on a terminal and in a pipe.

#include "app/output/interruptible.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

#include "support/paths.hpp"

namespace penumbra {
namespace {

using namespace std::chrono_literals;
using testing::EndsWith;
using testing::HasSubstr;

struct Count {
  std::atomic<std::size_t> done{0}, total{0};
};

// Redirects standard error to one end of a pipe or terminal and collects the text at the other end.
class CapturedError {
 public:
  CapturedError(int ours, int theirs) : read_end_(ours), saved_stderr_(dup(STDERR_FILENO)) {
    dup2(theirs, STDERR_FILENO);
    close(theirs);
    reader_ = std::jthread([this] {
      std::array<char, 256> block{};
      for (;;) {
        const ssize_t count = read(read_end_, block.data(), block.size());
        if (count <= 0) return;  // EIO: the other end of the terminal is closed
        const std::lock_guard lock(mutex_);
        text_.append(block.data(), static_cast<std::size_t>(count));
      }
    });
  }
  CapturedError(const CapturedError&) = delete;
  CapturedError& operator=(const CapturedError&) = delete;
  ~CapturedError() { static_cast<void>(finish()); }

  // Waits up to 30 s until the text contains `words`.
  [[nodiscard]] bool shows(const std::string& words) {
    for (int i = 0; i < 3000; ++i) {
      {
        const std::lock_guard lock(mutex_);
        if (text_.find(words) != std::string::npos) return true;
      }
      std::this_thread::sleep_for(10ms);
    }
    return false;
  }
  // Restores standard error and returns the collected text.
  [[nodiscard]] std::string finish() {
    if (saved_stderr_ >= 0) {
      dup2(saved_stderr_, STDERR_FILENO);
      close(std::exchange(saved_stderr_, -1));
      reader_.join();
      close(read_end_);
    }
    return text_;
  }

 private:
  int read_end_;
  int saved_stderr_;
  std::mutex mutex_;
  std::string text_;
  std::jthread reader_;
};

class WithProgress : public testing::Test {
 protected:
  test::TemporaryFolder folder_;
  InterruptWatch watch_;
  Count count_;

  template <class Work>
  int run(const Work& work) {
    watch_.hold();
    auto output = OutputFile::create(folder_.path() / "file");
    return with_progress(work, count_, "vertices", watch_, *output);
  }
};

TEST_F(WithProgress, DrawsAndErasesBarOnTerminal) {
  int ours = -1;
  int theirs = -1;
  ASSERT_EQ(openpty(&ours, &theirs, nullptr, nullptr, nullptr), 0);
  CapturedError error(ours, theirs);
  std::array<bool, 3> shown{};
  const int result = run([&] {
    shown[0] = error.shows("[" + std::string(30, ' ') + "]");  // empty bar before the first count
    count_.done = 50;
    count_.total = 200;
    shown[1] = error.shows("50/200");
    count_.done = 150;
    shown[2] = error.shows("150/200");
    return 7;
  });
  const std::string text = error.finish();
  EXPECT_EQ(result, 7);
  EXPECT_THAT(shown, testing::Each(true)) << text;
  EXPECT_THAT(text, HasSubstr("[" + std::string(22, '#') + std::string(8, ' ') + "]"));
  EXPECT_THAT(text, HasSubstr("vertices/s"));
  EXPECT_THAT(text, EndsWith("\r\033[K"));
}

TEST_F(WithProgress, DrawsNoBarForShortWork) {
  int ours = -1;
  int theirs = -1;
  ASSERT_EQ(openpty(&ours, &theirs, nullptr, nullptr, nullptr), 0);
  CapturedError error(ours, theirs);
  EXPECT_EQ(run([] { return 3; }), 3);
  EXPECT_EQ(error.finish(), "");
}

TEST_F(WithProgress, WritesNothingToPipe) {
  std::array<int, 2> ends{};
  ASSERT_EQ(pipe(ends.data()), 0);
  CapturedError error(ends[0], ends[1]);
  EXPECT_EQ(run([this] {
              count_.total = 10;
              std::this_thread::sleep_for(1300ms);  // long enough for a bar to appear on a terminal
              return 3;
            }),
            3);
  EXPECT_EQ(error.finish(), "");
}

}  // namespace
}  // namespace penumbra
