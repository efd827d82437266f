#include "app/viewer.hpp"

#include <gtest/gtest.h>

#include <deque>
#include <utility>

namespace penumbra {
namespace {

constexpr int kEscape = 256;  // GLFW's codes
constexpr int kSpace = 32;
constexpr int kQ = 81;
constexpr int kX = 88;

// A window whose keys are written down beforehand: one entry for each time that it is polled.
class ScriptedWindow final : public GlContext {
 public:
  explicit ScriptedWindow(std::deque<int> keys) : keys_(std::move(keys)) {}
  void make_current() override {}
  [[nodiscard]] const GlInfo& info() const override { return info_; }
  [[nodiscard]] bool poll_events() override {
    if (keys_.empty()) return open;
    const int key = keys_.front();
    keys_.pop_front();
    if (key != 0) handler_(key);
    return open;
  }
  void swap() override { ++swaps; }
  [[nodiscard]] Size window_size() const override { return {64, 48}; }
  void on_key(std::function<void(int)> handler) override { handler_ = std::move(handler); }

  bool open = true;
  int swaps = 0;

 private:
  GlInfo info_;
  std::deque<int> keys_;
  std::function<void(int)> handler_;
};

TEST(Viewer, ShowsEachPictureOnce) {
  ScriptedWindow window({0, kX, 0});
  InterruptWatch interrupt;
  Viewer viewer(window);
  int presented = 0;
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(viewer.show([&] { ++presented; }, interrupt));
  EXPECT_EQ(presented, 3);
  EXPECT_EQ(window.swaps, 3);
  EXPECT_EQ(viewer.paused_ms(), 0.0);
}

TEST(Viewer, EscapeAndQClose) {
  for (const int key : {kEscape, kQ}) {
    ScriptedWindow window({0, key});
    InterruptWatch interrupt;
    Viewer viewer(window);
    EXPECT_TRUE(viewer.show([] {}, interrupt));
    EXPECT_FALSE(viewer.show([] {}, interrupt));
  }
}

TEST(Viewer, AClosedWindowIsSeen) {
  ScriptedWindow window({});
  window.open = false;
  InterruptWatch interrupt;
  Viewer viewer(window);
  EXPECT_FALSE(viewer.show([] {}, interrupt));
}

TEST(Viewer, SpacePausesUntilSpace) {
  ScriptedWindow window({kSpace, 0, 0, kSpace, 0});
  InterruptWatch interrupt;
  Viewer viewer(window);
  EXPECT_TRUE(viewer.show([] {}, interrupt));
  EXPECT_EQ(window.swaps, 4) << "the picture is drawn again while it stands still";
  EXPECT_GT(viewer.paused_ms(), 0.0);
  EXPECT_TRUE(viewer.show([] {}, interrupt));
  EXPECT_EQ(window.swaps, 5);
}

TEST(Viewer, APauseEndsByClosing) {
  ScriptedWindow window({kSpace, 0, kEscape});
  InterruptWatch interrupt;
  Viewer viewer(window);
  EXPECT_FALSE(viewer.show([] {}, interrupt));
}

}  // namespace
}  // namespace penumbra
