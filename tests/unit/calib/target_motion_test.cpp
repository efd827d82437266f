// Row time by a calibration target in front of a moving camera. Every row is exposed at its time.
#include "calib/target/target_motion.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <utility>
#include <vector>

#include "support/cameras.hpp"
#include "support/rolling_camera.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

constexpr std::int64_t kInterval_ns = 33'333'333;
constexpr double kNoise_px = 0.05;

std::vector<TargetCorner> corners_at(const CameraModel& camera, const Target& target,
                                     std::int64_t time_ns, double row_s, double speed,
                                     std::mt19937& random) {
  std::normal_distribution<double> normal;
  std::vector<TargetCorner> corners;
  for (std::size_t i = 0; i < target.points.size(); ++i) {
    const Eigen::Vector2d pixel = test::rolling_pixel(
        camera, target.points[i], static_cast<double>(time_ns) * 1e-9, row_s, speed);
    if (pixel.x() < 4.0 || pixel.y() < 4.0 || pixel.x() > camera.width() - 5.0 ||
        pixel.y() > camera.height() - 5.0)
      continue;
    TargetCorner& corner = corners.emplace_back();
    corner.point = static_cast<int>(i);
    corner.pixel = pixel + kNoise_px * Eigen::Vector2d(normal(random), normal(random));
  }
  return corners;
}

class RowTimeOfTarget : public testing::Test {
 protected:
  [[nodiscard]] std::optional<RowTime> found(const Target& target, double row_s,
                                             double speed) const {
    std::mt19937 random(3);
    TargetMotion motion(target);
    for (int k = 0; k < 120; ++k) {
      const std::int64_t time_ns = k * kInterval_ns;
      motion.add(time_ns, corners_at(camera_, target, time_ns, row_s, speed, random));
    }
    return motion.row_time(camera_);
  }
  CameraModel camera_ = test::desk_camera();
  std::vector<Target> targets_ = {tag_target(TagMap::make(test::board(4, 3, 0.04)).value()).value(),
                                  chessboard_target(8, 6, 0.03).value(),
                                  charuco_target({}).value()};
};

TEST_F(RowTimeOfTarget, IsFoundWithEveryKindOfTarget) {
  for (const Target& target : targets_) {
    for (const double row_s : {15e-6, 40e-6}) {
      const auto row_time = found(target, row_s, 1.0);
      ASSERT_TRUE(row_time) << target.description << row_s;
      EXPECT_NEAR(row_time->seconds, row_s, 4.0 * row_time->sigma_s) << target.description;
      EXPECT_NEAR(row_time->seconds, row_s, 0.05 * row_s) << target.description;
    }
  }
}

TEST_F(RowTimeOfTarget, IsNotFoundForGlobalShutterOrCameraAtRest) {
  for (const Target& target : targets_) {
    EXPECT_FALSE(found(target, 0.0, 1.0)) << target.description;
    std::mt19937 random(4);
    TargetMotion rest(target);
    for (int k = 0; k < 60; ++k)
      rest.add(k * kInterval_ns, corners_at(camera_, target, 0, 40e-6, 1.0, random));
    EXPECT_FALSE(rest.row_time(camera_)) << target.description;
  }
}

TEST_F(RowTimeOfTarget, NeedsConsecutiveImages) {
  const Target& target = targets_.front();
  std::mt19937 random(5);
  TargetMotion seldom(target);
  TargetMotion backwards(target);
  for (int k = 0; k < 60; ++k) {
    const std::int64_t time_ns = k * kInterval_ns;
    const auto corners = corners_at(camera_, target, time_ns, 40e-6, 1.0, random);
    seldom.add(10 * time_ns, corners);
    backwards.add(-time_ns, corners);
  }
  EXPECT_FALSE(seldom.row_time(camera_));
  EXPECT_FALSE(backwards.row_time(camera_));
  EXPECT_FALSE(TargetMotion(target).row_time(camera_));
}

TEST_F(RowTimeOfTarget, IsNeverNonFinite) {
  const Target& target = targets_.front();
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), 1e300}) {
    std::mt19937 random(6);
    TargetMotion motion(target);
    for (int k = 0; k < 40; ++k) {
      const std::int64_t time_ns = k * kInterval_ns;
      auto corners = corners_at(camera_, target, time_ns, 40e-6, 1.0, random);
      if (k % 4 == 1) corners[static_cast<std::size_t>(k) % corners.size()].pixel.x() = bad;
      motion.add(time_ns, corners);
    }
    const auto row_time = motion.row_time(camera_);
    if (!row_time) continue;
    EXPECT_TRUE(std::isfinite(row_time->seconds) && std::isfinite(row_time->sigma_s)) << bad;
    EXPECT_NEAR(row_time->seconds, 40e-6, 4e-6) << bad;
  }
}

}  // namespace
}  // namespace penumbra
