#include "app/live/draw_pace.hpp"

#include <gtest/gtest.h>

namespace penumbra {
namespace {

constexpr std::int64_t kMillisecond_ns = 1'000'000;

TEST(DrawPace, HasNoEstimateBeforeFirstDraw) {
  DrawPace pace;
  EXPECT_FALSE(pace.begin_at_ns());
  pace.prepared(5 * kMillisecond_ns);
  EXPECT_FALSE(pace.begin_at_ns());
  pace.asked(0);  // no frame was available, so no drawing began
  EXPECT_FALSE(pace.begin_at_ns());
  pace.took(10 * kMillisecond_ns);
  EXPECT_FALSE(pace.begin_at_ns()) << "no drawing has ended";
}

TEST(DrawPace, StartsWorkJustInTimeForNextDraw) {
  DrawPace pace;
  pace.prepared(5 * kMillisecond_ns);
  pace.took(0);
  pace.asked(60 * kMillisecond_ns);
  EXPECT_FALSE(pace.begin_at_ns()) << "drawing waits for a frame";
  pace.took(70 * kMillisecond_ns);
  EXPECT_EQ(pace.begin_at_ns(), (70 + 60 - 5 - 1) * kMillisecond_ns);
  // The estimate uses the shortest recent drawing and the longest recent work.
  pace.asked(120 * kMillisecond_ns);
  pace.prepared(8 * kMillisecond_ns);
  pace.prepared(2 * kMillisecond_ns);
  pace.took(200 * kMillisecond_ns);
  EXPECT_EQ(pace.begin_at_ns(), (200 + 50 - 8 - 1) * kMillisecond_ns);
}

TEST(DrawPace, StartsWorkAtOnceWhenDrawingIsFaster) {
  DrawPace pace;
  pace.prepared(20 * kMillisecond_ns);
  pace.took(0);
  pace.asked(4 * kMillisecond_ns);
  pace.took(30 * kMillisecond_ns);
  EXPECT_EQ(pace.begin_at_ns(), 30 * kMillisecond_ns);
}

// The estimate forgets a slow frame and a window that was paused for a minute.
TEST(DrawPace, UsesOnlyRecentDurations) {
  DrawPace pace;
  std::int64_t now_ns = 0;
  const auto draw = [&](std::int64_t duration_ns) {
    pace.took(now_ns);
    now_ns += duration_ns;
    pace.asked(now_ns);
  };
  pace.prepared(50 * kMillisecond_ns);
  draw(10 * kMillisecond_ns);
  for (int i = 0; i < 8; ++i) {
    pace.prepared(5 * kMillisecond_ns);
    draw(60'000 * kMillisecond_ns);
  }
  draw(40 * kMillisecond_ns);
  pace.took(now_ns);
  EXPECT_EQ(*pace.begin_at_ns() - now_ns, (40 - 5 - 1) * kMillisecond_ns);
}

}  // namespace
}  // namespace penumbra
