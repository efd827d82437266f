#include "app/window/stall_display.hpp"

#include <gtest/gtest.h>

namespace penumbra {
namespace {

constexpr std::int64_t kMs = 1'000'000;

TrackedFrame frame_with(TrackStatus table, TrackStatus wall, double wall_age_s = 0.0) {
  TrackedFrame tracked;
  tracked.pose.status = table;
  tracked.pose.tags_used = 12;
  GroupEstimate& group = tracked.groups.emplace_back();
  group.name = "wall";
  group.status = wall;
  group.age_s = wall_age_s;
  if (wall == TrackStatus::held) group.held_from = TrackStatus::uncertain;
  return tracked;
}

TEST(StallDisplay, HasNothingToShowBeforeFirstFrame) {
  StallDisplay display;
  EXPECT_FALSE(display.holds());
  EXPECT_FALSE(display.frame_to_show(100 * kMs));
}

TEST(StallDisplay, CoastsPoseThenLosesIt) {
  for (const TrackStatus before : {TrackStatus::tracked, TrackStatus::uncertain}) {
    SCOPED_TRACE(to_string(before));
    StallDisplay display;
    display.observe(frame_with(before, TrackStatus::lost));
    const auto early = display.frame_to_show(100 * kMs);
    ASSERT_TRUE(early);
    EXPECT_EQ(early->pose.status, TrackStatus::held);
    EXPECT_EQ(early->pose.held_from, before) << "fading must start at the previous opacity";
    EXPECT_DOUBLE_EQ(early->pose.age_s, 0.1);
    EXPECT_EQ(early->pose.tags_used, 0) << "no tag is measured in a stale image";
    EXPECT_EQ(early->pose.reason.cause, PoseCause::no_complete_frame);
    EXPECT_EQ(early->groups[0].status, TrackStatus::lost) << "a lost group must stay lost";
    const auto again = display.frame_to_show(200 * kMs);
    ASSERT_TRUE(again);
    EXPECT_DOUBLE_EQ(again->pose.age_s, 0.2) << "the age counts from the frame";
    EXPECT_EQ(again->pose.held_from, before);
    const auto late = display.frame_to_show(static_cast<std::int64_t>(1.01e9 * kHoldSeconds));
    ASSERT_TRUE(late);
    EXPECT_EQ(late->pose.status, TrackStatus::lost);
    EXPECT_FALSE(display.holds()) << "the frame's buffer must return to the camera";
    EXPECT_FALSE(display.frame_to_show(static_cast<std::int64_t>(1.1e9 * kHoldSeconds)));
  }
}

TEST(StallDisplay, FadesEachGroupByItsAge) {
  const double half_s = 0.5 * kHoldSeconds;
  StallDisplay display;
  display.observe(frame_with(TrackStatus::tracked, TrackStatus::held, half_s));
  const auto stall_ns = static_cast<std::int64_t>(0.6e9 * kHoldSeconds);
  const auto shown = display.frame_to_show(stall_ns);
  ASSERT_TRUE(shown);
  EXPECT_EQ(shown->pose.status, TrackStatus::held);
  EXPECT_EQ(shown->groups[0].status, TrackStatus::lost);
  EXPECT_DOUBLE_EQ(shown->groups[0].age_s, half_s + 1e-9 * static_cast<double>(stall_ns));
  EXPECT_EQ(shown->groups[0].held_from, TrackStatus::uncertain)
      << "the group was coasting from this status";
  EXPECT_TRUE(display.holds()) << "the table's pose is still coasting";
}

}  // namespace
}  // namespace penumbra
