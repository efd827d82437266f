#include "app/live/draw_pace.hpp"

#include <gtest/gtest.h>

namespace penumbra {
namespace {

constexpr std::int64_t kMillisecond_ns = 1'000'000;

TEST(DrawPace, HasNoEstimateBeforeFirstDraw) {
  DrawPace pace;
  EXPECT_FALSE(pace.begin_at_ns());
  pace.add_preparation(5 * kMillisecond_ns);
  EXPECT_FALSE(pace.begin_at_ns());
  pace.image_requested(0);  // no frame was available, so no drawing began
  EXPECT_FALSE(pace.begin_at_ns());
  pace.image_taken(10 * kMillisecond_ns);
  EXPECT_FALSE(pace.begin_at_ns()) << "no drawing has ended";
}

TEST(DrawPace, StartsWorkJustInTimeForNextDraw) {
  DrawPace pace;
  pace.add_preparation(5 * kMillisecond_ns);
  pace.image_taken(0);
  pace.image_requested(60 * kMillisecond_ns);
  EXPECT_FALSE(pace.begin_at_ns()) << "drawing waits for a frame";
  pace.image_taken(70 * kMillisecond_ns);
  EXPECT_EQ(pace.begin_at_ns(), (70 + 60 - 5 - 1) * kMillisecond_ns);
  // The estimate uses the shortest recent drawing and the longest recent work.
  pace.image_requested(120 * kMillisecond_ns);
  pace.add_preparation(8 * kMillisecond_ns);
  pace.add_preparation(2 * kMillisecond_ns);
  pace.image_taken(200 * kMillisecond_ns);
  EXPECT_EQ(pace.begin_at_ns(), (200 + 50 - 8 - 1) * kMillisecond_ns);
}

TEST(DrawPace, StartsWorkAtOnceWhenDrawingIsFaster) {
  DrawPace pace;
  pace.add_preparation(20 * kMillisecond_ns);
  pace.image_taken(0);
  pace.image_requested(4 * kMillisecond_ns);
  pace.image_taken(30 * kMillisecond_ns);
  EXPECT_EQ(pace.begin_at_ns(), 30 * kMillisecond_ns);
}

// The estimate forgets a slow frame and a window that was paused for a minute.
TEST(DrawPace, UsesOnlyRecentDurations) {
  DrawPace pace;
  std::int64_t now_ns = 0;
  const auto draw = [&](std::int64_t duration_ns) {
    pace.image_taken(now_ns);
    now_ns += duration_ns;
    pace.image_requested(now_ns);
  };
  pace.add_preparation(50 * kMillisecond_ns);
  draw(10 * kMillisecond_ns);
  for (int i = 0; i < 8; ++i) {
    pace.add_preparation(5 * kMillisecond_ns);
    draw(60'000 * kMillisecond_ns);
  }
  draw(40 * kMillisecond_ns);
  pace.image_taken(now_ns);
  EXPECT_EQ(*pace.begin_at_ns() - now_ns, (40 - 5 - 1) * kMillisecond_ns);
}

}  // namespace
}  // namespace penumbra
