#include "core/evaluation/pairing.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <numbers>
#include <random>
#include <set>
#include <string>

#include "core/units.hpp"

namespace penumbra {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kMaxGap = 100 * kMs;

CameraPose at_x(double x, double angle = 0.0) {
  return {Eigen::Quaterniond(Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ())),
          Eigen::Vector3d(x, 0.0, 1.0)};
}

// A trajectory with a pose every `interval_ns`, moving by 1 m/s along x and 2 rad/s about z.
Trajectory even_motion(int count, std::int64_t interval_ns, std::int64_t start_ns = 0) {
  Trajectory t;
  for (int i = 0; i < count; ++i) {
    const double s = seconds(i * interval_ns);
    t.poses.push_back({start_ns + i * interval_ns, at_x(s, 2.0 * s), {}});
  }
  return t;
}

TEST(Pairing, InterpolatesPositionLinearlyAndRotationBySlerp) {
  const Trajectory truth = even_motion(100, 10 * kMs);
  for (const std::int64_t time : {3 * kMs, 15 * kMs, 77 * kMs + 123'456, 988 * kMs}) {
    const auto pose = pose_at(truth, time, kMaxGap);
    ASSERT_TRUE(pose) << time;
    EXPECT_NEAR(pose->translation().x(), seconds(time), 1e-12);
    EXPECT_LT(pose->rotation().angularDistance(at_x(0.0, 2.0 * seconds(time)).rotation()), 1e-7);
  }
}

TEST(Pairing, ReturnsExactPoseWhenTimesDifferByRounding) {
  const Trajectory truth = even_motion(10, 10 * kMs, 1'403'636'579'763'555'527);
  for (std::size_t i = 0; i < truth.poses.size(); ++i) {
    for (const std::int64_t off : {-1000, -500, 0, 499, 1000}) {
      const auto pose = pose_at(truth, truth.poses[i].timestamp_ns + off, kMaxGap);
      ASSERT_TRUE(pose);
      EXPECT_EQ(pose->translation(), truth.poses[i].T_table_camera.translation());
      EXPECT_EQ(pose->rotation().coeffs(), truth.poses[i].T_table_camera.rotation().coeffs());
    }
  }
}

TEST(Pairing, ReportsReasonForMissingTruePose) {
  Trajectory truth = even_motion(3, 50 * kMs);  // poses from 0 to 100 ms
  truth.poses.push_back({300 * kMs, at_x(0.3), {}});
  EXPECT_TRUE(pose_at(truth, 60 * kMs, kMaxGap));
  EXPECT_EQ(pose_at(truth, 200 * kMs, kMaxGap).error(), NotEvaluated::gap_too_long);
  EXPECT_TRUE(pose_at(truth, 200 * kMs, 200 * kMs)) << "a gap of exactly the maximum length";
  EXPECT_EQ(pose_at(truth, 200 * kMs, 200 * kMs - 1).error(), NotEvaluated::gap_too_long);
  // Extrapolates up to 10 ms beyond an end, unless the interval at that end is a long gap.
  EXPECT_NEAR(pose_at(truth, -10 * kMs, kMaxGap)->translation().x(), -0.01, 1e-12);
  EXPECT_EQ(pose_at(truth, -10 * kMs - 1, kMaxGap).error(), NotEvaluated::outside_truth);
  EXPECT_EQ(pose_at(truth, 302 * kMs, kMaxGap).error(), NotEvaluated::outside_truth);
  // Without interpolation, uses a pose that is at most 1 ms away.
  EXPECT_EQ(pose_at(truth, 300 * kMs + kMs, kMaxGap)->translation().x(), 0.3);
  EXPECT_EQ(pose_at(truth, 100 * kMs + kMs, kMaxGap)->translation().x(), 0.1);
  EXPECT_EQ(pose_at(truth, 101 * kMs + 1, kMaxGap).error(), NotEvaluated::gap_too_long);
  EXPECT_EQ(pose_at(Trajectory{}, 0, kMaxGap).error(), NotEvaluated::outside_truth);
  Trajectory one;
  one.poses = {truth.poses[0]};
  EXPECT_TRUE(pose_at(one, 0, kMaxGap));
  EXPECT_EQ(pose_at(one, 2 * kMs, kMaxGap).error(), NotEvaluated::outside_truth);
}

TEST(Pairing, ExtrapolatesUpToHalfIntervalOrTenMilliseconds) {
  struct Case {
    std::int64_t interval_ns;
    std::int64_t max_extrapolation_ns;
  };
  for (const auto& [interval, max_extrapolation] :
       {Case{5 * kMs, 2'500'000}, Case{10 * kMs, 5 * kMs}, Case{100 * kMs, 10 * kMs},
        Case{1000 * kMs, 10 * kMs}, Case{2000 * kMs, 10 * kMs}}) {
    const Trajectory truth = even_motion(5, interval);
    const std::int64_t last = 4 * interval;
    for (const std::int64_t time : {-max_extrapolation, last + max_extrapolation}) {
      const auto pose = pose_at(truth, time, 2000 * kMs);
      ASSERT_TRUE(pose) << interval;
      EXPECT_NEAR(pose->translation().x(), seconds(time), 1e-12);
    }
    for (const std::int64_t time :
         {-max_extrapolation - 1, last + max_extrapolation + 1, -interval / 2 - 1})
      EXPECT_EQ(pose_at(truth, time, 2000 * kMs).error(), NotEvaluated::outside_truth) << interval;
  }
}

TEST(Pairing, UsesOnlyPosesWithinOneMillisecondWithoutInterpolation) {
  const Trajectory truth = even_motion(10, 10 * kMs);
  EXPECT_EQ(pose_at(truth, 21 * kMs, 0)->translation().x(), 0.02);
  EXPECT_EQ(pose_at(truth, 25 * kMs, 0).error(), NotEvaluated::gap_too_long);
}

TEST(Pairing, InterpolatesShortestRotationNearHalfTurns) {
  for (const double angle : {0.0, 1e-12, 1.0, std::numbers::pi - 1e-9, std::numbers::pi,
                             std::numbers::pi + 1e-9, 2.0 * std::numbers::pi - 1e-12}) {
    for (const double sign : {1.0, -1.0}) {
      Trajectory truth;
      truth.poses.push_back({0, at_x(0.0), {}});
      const Eigen::Quaterniond end = at_x(0.0, angle).rotation();
      truth.poses.push_back(
          {10 * kMs,
           CameraPose(Eigen::Quaterniond(sign * end.coeffs()), Eigen::Vector3d::Zero()),
           {}});
      const double turn = angle > std::numbers::pi ? 2.0 * std::numbers::pi - angle : angle;
      for (const std::int64_t time : {-5 * kMs, 2 * kMs, 5 * kMs, 8 * kMs, 15 * kMs}) {
        const auto pose = pose_at(truth, time, kMaxGap);
        ASSERT_TRUE(pose && pose->is_finite());
        EXPECT_NEAR(pose->rotation().norm(), 1.0, 1e-12);
        EXPECT_NEAR(pose->rotation().angularDistance(Eigen::Quaterniond::Identity()),
                    std::min(std::abs(seconds(time)) / 0.01 * turn,
                             2.0 * std::numbers::pi - std::abs(seconds(time)) / 0.01 * turn),
                    1e-6)
            << angle << " " << time;
      }
    }
  }
}

// For any times and poses, the interpolated pose must be finite and lie between its neighbours.
TEST(Pairing, StaysOnSegmentForAnyTimes) {
  std::mt19937_64 random(7);
  constexpr std::int64_t kMaxTime_ns = 4'000'000'000'000'000'000;
  std::uniform_int_distribution<std::int64_t> any_time(-kMaxTime_ns, kMaxTime_ns);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> size(-9.0, 9.0);
  int evaluated = 0;
  for (int trial = 0; trial < 3000; ++trial) {
    Trajectory truth;
    std::set<std::int64_t> times;
    const bool near = trial % 2 == 0;
    const std::int64_t start = any_time(random) / 2;
    for (int i = 0; i < 5; ++i)
      times.insert(near ? start + static_cast<std::int64_t>(random() % 1'000'000'000)
                        : any_time(random));
    for (const std::int64_t time : times) {
      const double metres = std::pow(10.0, size(random));
      truth.poses.push_back(
          {time,
           CameraPose(
               Eigen::Quaterniond(normal(random), normal(random), normal(random), normal(random)),
               metres * Eigen::Vector3d(normal(random), normal(random), normal(random))),
           {}});
    }
    const std::int64_t time = shifted(
        near ? start + static_cast<std::int64_t>(random() % 1'000'000'000) : any_time(random),
        trial % 3 == 0 ? any_time(random) / 1'000'000'000 : 0);
    const std::int64_t gap = trial % 5 == 0 ? std::numeric_limits<std::int64_t>::max() : kMaxGap;
    const auto pose = pose_at(truth, time, gap);
    if (!pose) continue;
    ++evaluated;
    EXPECT_TRUE(pose->is_finite());
    EXPECT_NEAR(pose->rotation().norm(), 1.0, 1e-12);
    const auto after = std::ranges::lower_bound(truth.poses, time, {}, &StampedPose::timestamp_ns);
    if (after == truth.poses.begin() || after == truth.poses.end()) continue;
    const Eigen::Vector3d& a = std::prev(after)->T_table_camera.translation();
    const Eigen::Vector3d& b = after->T_table_camera.translation();
    EXPECT_LE((pose->translation() - a).norm() + (pose->translation() - b).norm(),
              (a - b).norm() * (1.0 + 1e-9) + 1e-12);
  }
  EXPECT_GT(evaluated, 300);
}

TEST(Pairing, SaturatesShiftedTimes) {
  constexpr std::int64_t kMax_ns = std::numeric_limits<std::int64_t>::max();
  EXPECT_EQ(shifted(5, -7), -2);
  EXPECT_EQ(shifted(kMax_ns - 1, 5), kMax_ns);
  EXPECT_EQ(shifted(-kMax_ns, -5), std::numeric_limits<std::int64_t>::min());
}

TEST(Pairing, IgnoresLostFramesInMedianInterval) {
  Trajectory t = even_motion(10, 33 * kMs);
  t.poses.erase(t.poses.begin() + 4, t.poses.begin() + 6);
  EXPECT_EQ(median_interval_ns(t), 33 * kMs);
  EXPECT_EQ(median_interval_ns(Trajectory{}), 0);
}

std::string unit_error(const Trajectory& estimated, const Trajectory& truth) {
  const auto checked = check_units_of_time({estimated, "e.tum"}, {truth, "t.tum"}, {});
  return checked ? "" : checked.error().message;
}

TEST(TimestampUnits, AreRejectedWhenTimesFitAnotherUnit) {
  const Trajectory truth = even_motion(120, 33 * kMs);
  EXPECT_EQ(unit_error(truth, truth), "");
  EXPECT_EQ(unit_error(even_motion(120, 5 * kMs), even_motion(60, 10 * kMs)), "");
  EXPECT_EQ(unit_error(even_motion(4, 1'000 * kMs), even_motion(4, 1'000 * kMs)), "")
      << "images taken once per second";
  struct Unit {
    std::int64_t factor;
    const char* name;
  };
  for (const auto& [factor, name] : {Unit{1'000, "milliseconds"}, Unit{1'000'000, "microseconds"},
                                     Unit{1'000'000'000, "nanoseconds"}}) {
    const Trajectory other = even_motion(120, 33 * kMs * factor);
    EXPECT_THAT(unit_error(other, truth), AllOf(HasSubstr("e.tum"), HasSubstr(name)));
    EXPECT_THAT(unit_error(truth, other), AllOf(HasSubstr("t.tum"), HasSubstr(name)));
    // Both files have the same wrong unit, and their times do not overlap. The long intervals are
    // reported with the unit.
    EXPECT_THAT(unit_error(other, even_motion(120, 33 * kMs * factor, -4'000 * factor * kMs)),
                AllOf(HasSubstr("e.tum"), HasSubstr(name)));
  }
  // At 200 frames/s, times in milliseconds look like intervals of 5 s. Such intervals are
  // plausible, so only the other file reveals the unit.
  EXPECT_THAT(unit_error(even_motion(120, 5'000 * kMs), even_motion(120, 5 * kMs)),
              AllOf(HasSubstr("e.tum"), HasSubstr("milliseconds")));
  EXPECT_THAT(unit_error(even_motion(120, 5 * kMs), even_motion(120, 5'000 * kMs)),
              AllOf(HasSubstr("t.tum"), HasSubstr("milliseconds")));
  EXPECT_THAT(unit_error(even_motion(120, 33), truth), HasSubstr("too near"));
}

TEST(TimestampUnits, WarnOfLongIntervalsBetweenPoses) {
  // Photographs, one every 10 s, compared with themselves and with motion capture at 100 Hz.
  const Trajectory photographs = even_motion(12, 10'000 * kMs);
  const auto same = check_units_of_time({photographs, "e.tum"}, {photographs, "t.tum"}, {});
  ASSERT_TRUE(same) << same.error().message;
  ASSERT_EQ(same->size(), 2U);
  EXPECT_THAT(same->at(0), AllOf(HasSubstr("e.tum"), HasSubstr("10 s apart")));
  const Trajectory capture = even_motion(12'000, 10 * kMs);
  const auto captured = check_units_of_time({photographs, "e.tum"}, {capture, "t.tum"}, {});
  ASSERT_TRUE(captured) << captured.error().message;
  EXPECT_THAT(*captured, testing::ElementsAre(HasSubstr("e.tum")));
  EXPECT_THAT(*check_units_of_time({capture, "e.tum"}, {capture, "t.tum"}, {}), testing::IsEmpty());
}

TEST(TimestampUnits, AreAcceptedWhenTimesDoNotOverlap) {
  const Trajectory truth = even_motion(120, 33 * kMs);
  EXPECT_EQ(unit_error(even_motion(120, 33 * kMs, 1'000'000 * kMs), truth), "");
  EXPECT_EQ(unit_error(even_motion(1, 33 * kMs), truth), "");
  EXPECT_EQ(unit_error(Trajectory{}, truth), "");
}

}  // namespace
}  // namespace penumbra
