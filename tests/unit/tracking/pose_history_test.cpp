#include "tracking/motion/pose_history.hpp"

#include <gtest/gtest.h>

#include <cstdint>

#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

constexpr std::int64_t kFrame_ns = 33'333'333;

MapPoseEstimate tracked_at(double x_m) {
  MapPoseEstimate estimate;
  estimate.status = TrackStatus::tracked;
  estimate.T_map_camera = {Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0), {x_m, 0.0, 0.5}};
  estimate.covariance = 1e-8 * Eigen::Matrix<double, 6, 6>::Identity();
  return estimate;
}

// History after frames 1, 2, ... of a camera that moves by 10 mm per frame.
PoseHistory steady_history(int frames) {
  PoseHistory history;
  for (int f = 1; f <= frames; ++f) {
    history.begin_frame(f * kFrame_ns);
    history.add(f * kFrame_ns, tracked_at(0.01 * f), true, true);
  }
  return history;
}

TEST(PoseHistory, PredictsNothingBeforeFirstPose) {
  PoseHistory history;
  history.begin_frame(kFrame_ns);
  EXPECT_FALSE(history.predict(kFrame_ns));
  EXPECT_EQ(history.frame_interval_s(), 0.0);
  EXPECT_EQ(history.coast(test::wide_camera(), kFrame_ns, 0.5, {PoseCause::no_tag}).status,
            TrackStatus::lost);
}

TEST(PoseHistory, PredictsConstantVelocity) {
  PoseHistory history = steady_history(2);
  history.begin_frame(3 * kFrame_ns);
  EXPECT_NEAR(history.frame_interval_s(), 1.0 / 30.0, 1e-6);
  const auto predicted = history.predict(4 * kFrame_ns);
  ASSERT_TRUE(predicted);
  EXPECT_NEAR(predicted->translation().x(), 0.04, 1e-9);
}

TEST(PoseHistory, EndsRecentPredictionAfterLifetime) {
  const PoseHistory history = steady_history(2);
  EXPECT_TRUE(history.recent_prediction(3 * kFrame_ns));
  EXPECT_FALSE(history.recent_prediction(2 * kFrame_ns + 250'000'000));
}

TEST(PoseHistory, ForgetsPosesWhenClockJumpsBack) {
  PoseHistory history = steady_history(3);
  history.begin_frame(2 * kFrame_ns);
  EXPECT_FALSE(history.predict(2 * kFrame_ns));
  EXPECT_FALSE(history.motion_at(2 * kFrame_ns, tracked_at(0.0).T_map_camera));
}

TEST(PoseHistory, DerivesChangeOfVelocityFromThreePoses) {
  const PoseHistory history = steady_history(2);
  const auto steady = history.motion_at(3 * kFrame_ns, tracked_at(0.03).T_map_camera);
  ASSERT_TRUE(steady);
  EXPECT_FALSE(steady->of_one_step);
  EXPECT_NEAR(steady->velocity.head<3>().norm(), 0.3, 1e-6);
  EXPECT_NEAR(steady->change.norm(), 0.0, 1e-6);
  const auto faster = history.motion_at(3 * kFrame_ns, tracked_at(0.04).T_map_camera);
  ASSERT_TRUE(faster);
  EXPECT_NEAR(faster->change.head<3>().norm(), 0.3, 1e-6);
  EXPECT_NEAR(faster->velocity.head<3>().norm(), 0.75, 1e-6);
}

TEST(PoseHistory, DerivesNoMotionFromAmbiguousPoses) {
  PoseHistory history;
  history.begin_frame(kFrame_ns);
  history.add(kFrame_ns, tracked_at(0.0), false, true);
  EXPECT_FALSE(history.motion_at(2 * kFrame_ns, tracked_at(0.01).T_map_camera));
  EXPECT_TRUE(history.predict(2 * kFrame_ns));
}

TEST(PoseHistory, CoastsWithGrowingErrorUntilHoldTime) {
  const PoseHistory history = steady_history(2);
  const CameraModel camera = test::wide_camera();
  const MapPoseEstimate soon = history.coast(camera, 3 * kFrame_ns, 0.1, {PoseCause::no_tag});
  const MapPoseEstimate later = history.coast(camera, 4 * kFrame_ns, 0.1, {PoseCause::no_tag});
  EXPECT_EQ(soon.status, TrackStatus::held);
  EXPECT_EQ(soon.held_from, TrackStatus::tracked);
  EXPECT_EQ(soon.reason.cause, PoseCause::no_tag);
  EXPECT_GT(later.predicted_overlay_error_px, soon.predicted_overlay_error_px);
  EXPECT_EQ(history.coast(camera, 6 * kFrame_ns, 0.1, {PoseCause::no_tag}).status,
            TrackStatus::lost);
}

}  // namespace
}  // namespace penumbra
