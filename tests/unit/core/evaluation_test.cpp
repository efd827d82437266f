#include "core/evaluation/evaluation.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <random>

#include "support/cameras.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

// A camera with a focal length of 500 px and no distortion.
// Camera straight above the table at height z that looks down. Its x axis is the table's x axis;
// its y and z axes are opposite to the table's axes.
CameraPose above(double x, double y, double z) {
  return {Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0), Eigen::Vector3d(x, y, z)};
}

TEST(Evaluation, InterpolatesPercentiles) {
  const Statistics s = statistics_of({4.0, 1.0, 3.0, 2.0});
  EXPECT_DOUBLE_EQ(s.median, 2.5);
  EXPECT_DOUBLE_EQ(s.max, 4.0);
  EXPECT_DOUBLE_EQ(s.rmse, std::sqrt(30.0 / 4.0));
  EXPECT_DOUBLE_EQ(s.p95, 3.0 + 0.85);  // position 0.95 * 3 = 2.85
  EXPECT_EQ(statistics_of({}).max, 0.0);
  EXPECT_EQ(statistics_of({7.0}).p95, 7.0);
}

TEST(Evaluation, PlacesOverlayCubeOnTable) {
  const auto cube = overlay_cube();
  int low = 0;
  for (const Eigen::Vector3d& p : cube) {
    EXPECT_DOUBLE_EQ(std::abs(p.x()), 0.1);
    EXPECT_DOUBLE_EQ(std::abs(p.y()), 0.1);
    EXPECT_TRUE(p.z() == 0.0 || p.z() == 0.2);
    low += p.z() == 0.0 ? 1 : 0;
  }
  EXPECT_EQ(low, 4);
}

TEST(Evaluation, MatchesHandComputedCornerShifts) {
  // Seen from 1 m, a shift of 1 mm moves the corners on the table by 500 * 0.001 / 1 = 0.5 px and
  // those at 0.2 m by 500 * 0.001 / 0.8 = 0.625 px, against the shift.
  const OverlayDifference d =
      overlay_difference(test::pinhole_camera(), above(0.001, 0.0, 1.0), above(0.0, 0.0, 1.0));
  for (std::size_t i = 0; i < 8; ++i) {
    ASSERT_TRUE(d.valid[i]);
    const double expected = overlay_cube()[i].z() == 0.0 ? 0.5 : 0.625;
    EXPECT_NEAR(d.difference_px[i].x(), -expected, 1e-9);
    EXPECT_NEAR(d.difference_px[i].y(), 0.0, 1e-9);
  }
  EXPECT_NEAR(d.rms_px(), std::sqrt((0.25 + 0.390625) / 2.0), 1e-9);
}

TEST(Evaluation, IgnoresCornersBehindCamera) {
  const OverlayDifference d =
      overlay_difference(test::pinhole_camera(), above(0.0, 0.0, 0.1), above(0.0, 0.0, 0.1));
  for (std::size_t i = 0; i < 8; ++i) EXPECT_EQ(d.valid[i], overlay_cube()[i].z() == 0.0);
  EXPECT_EQ(d.rms_px(), 0.0);
}

TEST(Evaluation, GivesLargeErrorToPoseWithoutVisibleCorners) {
  // The estimated camera is below the table and looks away, so it sees no corner. The true camera
  // sees all.
  const OverlayDifference d =
      overlay_difference(test::pinhole_camera(), above(0, 0, -1.0), above(0, 0, 1.0));
  for (std::size_t i = 0; i < 8; ++i) {
    EXPECT_TRUE(d.valid[i]);
    // The error is at least a quarter turn at 500 px per radian.
    EXPECT_GT(d.difference_px[i].norm(), 500.0 * std::numbers::pi / 2.0);
    EXPECT_LE(d.difference_px[i].norm(), 500.0 * std::numbers::pi);
  }
  Trajectory truth;
  Trajectory estimated;
  truth.poses.push_back({0, above(0, 0, 1.0), {}});
  estimated.poses.push_back({0, above(0, 0, -1.0), {}});
  const Evaluation e = evaluate(test::pinhole_camera(), estimated, truth);
  EXPECT_GT(e.overlay_px.median, 700.0);
  EXPECT_EQ(e.jitter_changes, 0) << "a single frame has no jitter value";
}

TEST(Evaluation, MatchesHandComputedRecording) {
  Trajectory truth;
  Trajectory estimated;
  for (int i = 0; i < 5; ++i) truth.poses.push_back({i * 33'333'000LL, above(0.0, 0.0, 1.0), {}});
  // Frame 2 has no pose. Frame 3's timestamp is off by 0.4 ms.
  estimated.poses.push_back({0, above(0.0, 0.0, 1.0), {}});
  estimated.poses.push_back({33'333'000, above(0.001, 0.0, 1.0), {}});
  estimated.poses.push_back({3 * 33'333'000LL + 400'000, above(0.0, 0.002, 1.0), {}});
  estimated.poses.push_back({4 * 33'333'000LL, above(0.0, 0.002, 1.0), {}});
  estimated.poses.push_back({9'000'000'000, above(0.0, 0.0, 5.0), {}});  // no truth at this time

  const Evaluation e = evaluate(test::pinhole_camera(), estimated, truth);
  EXPECT_EQ(e.frames_with_truth, 5);
  EXPECT_EQ(e.frames_estimated, 5);
  EXPECT_EQ(e.frames_judged, 4);
  EXPECT_EQ(e.frames_with_pose, 4);
  EXPECT_EQ(e.frames_not_judged[static_cast<std::size_t>(NotEvaluated::outside_truth)], 1);
  EXPECT_NEAR(e.translation_mm.max, 2.0, 1e-9);
  EXPECT_NEAR(e.translation_mm.median, 1.5, 1e-9);
  EXPECT_NEAR(e.rotation_deg.max, 0.0, 1e-9);
  // Corner errors [px]: 8 times 0, 4 times 0.5, 4 times 0.625, then twice 4 times 1 and 4 times
  // 1.25.
  EXPECT_NEAR(e.overlay_px.max, 1.25, 1e-9);
  EXPECT_NEAR(e.overlay_px.rmse, std::sqrt((4 * 0.25 + 4 * 0.390625 + 8 * 1.0 + 8 * 1.5625) / 32.0),
              1e-9);
  EXPECT_NEAR(e.overlay_frame_px.max, std::sqrt((1.0 + 1.5625) / 2.0), 1e-9);
  EXPECT_EQ(e.jitter_changes, 16);
  // Frame-to-frame changes: 0-1 (0.5 and 0.625) and 3-4 (no change). The pairs 1-2 and 2-3 lack a
  // pose.
  EXPECT_NEAR(e.jitter_px, std::sqrt((4 * 0.25 + 4 * 0.390625) / 16.0), 1e-9);

  ASSERT_EQ(e.poses.size(), 5U);
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_EQ(e.poses[i].timestamp_ns, estimated.poses[i].timestamp_ns);
    EXPECT_EQ(e.poses[i].not_judged,
              i < 4 ? std::nullopt : std::optional(NotEvaluated::outside_truth));
  }
  EXPECT_NEAR(e.poses[1].translation_mm, 1.0, 1e-9);
  EXPECT_NEAR(*e.poses[1].overlay_px, std::sqrt((0.25 + 0.390625) / 2.0), 1e-9);
  EXPECT_NEAR(*e.poses[2].overlay_px, std::sqrt((1.0 + 1.5625) / 2.0), 1e-9);
  EXPECT_EQ(e.poses[0].jitter_px, std::nullopt);
  EXPECT_NEAR(*e.poses[1].jitter_px, std::sqrt((0.25 + 0.390625) / 2.0), 1e-9);
  EXPECT_EQ(e.poses[2].jitter_px, std::nullopt) << "the frame before has no pose";
  EXPECT_NEAR(*e.poses[3].jitter_px, 0.0, 1e-9);
  EXPECT_EQ(e.poses[4].overlay_px, std::nullopt);
  EXPECT_EQ(e.poses[4].ratio, std::nullopt);
}

TEST(Evaluation, DividesOverlayErrorByPredictedError) {
  Trajectory truth;
  Trajectory estimated;
  for (int i = 0; i < 6; ++i) truth.poses.push_back({i * 33'333'000LL, above(0.0, 0.0, 1.0), {}});
  for (int i = 0; i < 4; ++i)
    estimated.poses.push_back({i * 33'333'000LL, above(0.001, 0.0, 1.0), {}});
  const double error_px = std::sqrt((0.25 + 0.390625) / 2.0);
  estimated.poses[0].predicted_px = error_px;
  estimated.poses[1].predicted_px = 2.0 * error_px;
  estimated.poses[2].predicted_px = error_px / 4.0;
  estimated.poses[3].predicted_px = std::nullopt;
  const double infinite = std::numeric_limits<double>::infinity();
  estimated.poses.push_back({4 * 33'333'000LL, above(0.001, 0.0, 1.0), {}, infinite});
  estimated.poses.push_back({5 * 33'333'000LL, above(0.001, 0.0, 1.0), {}, 0.0});
  const Evaluation e = evaluate(test::pinhole_camera(), estimated, truth);
  EXPECT_EQ(e.frames_judged, 6);
  EXPECT_EQ(e.frames_with_ratio, 4) << "no prediction, or a prediction of 0";
  EXPECT_NEAR(e.frame_ratio.max, 4.0, 1e-9);
  EXPECT_NEAR(e.frame_ratio.median, 0.75, 1e-9);
  EXPECT_NEAR(e.share_above_3, 0.25, 1e-12);
  EXPECT_NEAR(*e.poses[1].ratio, 0.5, 1e-9);
  EXPECT_EQ(e.poses[1].predicted_px, estimated.poses[1].predicted_px);
  EXPECT_EQ(e.poses[3].ratio, std::nullopt);
  EXPECT_EQ(e.poses[4].ratio, 0.0);
  EXPECT_EQ(e.poses[5].ratio, std::nullopt);

  for (StampedPose& pose : estimated.poses) pose.predicted_px = std::nullopt;
  const Evaluation unpredicted = evaluate(test::pinhole_camera(), estimated, truth);
  EXPECT_EQ(unpredicted.frames_with_ratio, 0);
  EXPECT_EQ(unpredicted.share_above_3, 0.0);
}

// A circle of radius 0.3 m at 2 rad/s, sampled by motion capture at 100 Hz. All estimates are at
// the middle of an interval, where the chord is inside the circle by r (1 - cos(w T / 2)).
TEST(Evaluation, InterpolatesTruthWithChordError) {
  constexpr double kRadius = 0.3;
  constexpr double kRate = 2.0;
  constexpr std::int64_t kInterval = 10'000'000;
  const auto on_circle = [](std::int64_t time_ns) {
    const double a = kRate * 1e-9 * static_cast<double>(time_ns);
    return above(kRadius * std::cos(a), kRadius * std::sin(a), 1.0);
  };
  Trajectory truth;
  Trajectory estimated;
  for (int i = 0; i <= 300; ++i)
    truth.poses.push_back({i * kInterval, on_circle(i * kInterval), {}});
  for (int i = 0; i < 100; ++i) {
    const std::int64_t time = 3 * i * kInterval + kInterval / 2;
    estimated.poses.push_back({time, on_circle(time), {}});
  }
  const Evaluation e = evaluate(test::pinhole_camera(), estimated, truth);
  EXPECT_EQ(e.frames_judged, 100);
  EXPECT_NEAR(e.translation_mm.rmse, 1e3 * kRadius * (1.0 - std::cos(kRate * 0.005)), 1e-9);
  EXPECT_NEAR(e.translation_mm.max, e.translation_mm.rmse, 1e-9);
  EXPECT_EQ(e.jitter_changes, 99 * 8) << "consecutive frames use every third true pose, each once";

  // A clock offset of 20 ms shifts the estimate by the motion during 20 ms.
  Trajectory behind = estimated;
  for (StampedPose& pose : behind.poses) pose.timestamp_ns -= 20'000'000;
  const Evaluation late = evaluate(test::pinhole_camera(), behind, truth);
  EXPECT_NEAR(late.translation_mm.median, 1e3 * 2.0 * kRadius * std::sin(kRate * 0.01), 0.02);
  EXPECT_EQ(evaluate(test::pinhole_camera(), behind, truth, {.time_offset_ns = 20'000'000})
                .translation_mm.rmse,
            e.translation_mm.rmse);
}

// The estimate has three times as many poses as the truth. Each true pose must count once.
TEST(Evaluation, CountsEachTruePoseOnce) {
  Trajectory truth;
  Trajectory estimated;
  for (int i = 0; i < 6; ++i) truth.poses.push_back({i * 90'000'000LL, above(0, 0, 1), {}});
  for (int i = 0; i < 30; ++i) estimated.poses.push_back({i * 30'000'000LL, above(0, 0, 1), {}});
  const Evaluation e = evaluate(test::pinhole_camera(), estimated, truth);
  EXPECT_EQ(e.frames_judged, 16);
  EXPECT_EQ(e.frames_with_pose, 6);
  EXPECT_EQ(e.frames_with_truth, 6);
}

TEST(Evaluation, CountsUnevaluatedFramesByCause) {
  Trajectory truth;
  Trajectory estimated;
  for (const int ms : {0, 33, 67, 267, 300})
    truth.poses.push_back({ms * 1'000'000LL, above(0, 0, 1), {}});
  for (const int ms : {-200, 10, 50, 100, 150, 280, 500, 600})
    estimated.poses.push_back({ms * 1'000'000LL, above(0, 0, 1), {}});
  const Evaluation e = evaluate(test::pinhole_camera(), estimated, truth);
  EXPECT_EQ(e.frames_estimated, 8);
  EXPECT_EQ(e.frames_judged, 3);
  EXPECT_EQ(e.frames_with_pose, 3);
  EXPECT_EQ(e.frames_not_judged[static_cast<std::size_t>(NotEvaluated::outside_truth)], 3);
  EXPECT_EQ(e.frames_not_judged[static_cast<std::size_t>(NotEvaluated::gap_too_long)], 2);
  EXPECT_EQ(
      evaluate(test::pinhole_camera(), estimated, truth, {.max_gap_ns = 200'000'000}).frames_judged,
      5);
}

// The shared case: 20 frames at 30 Hz against motion capture at 100 Hz. The expected values come
// from an independent calculation in Python (bisection, quaternion logarithm and exponential).
TEST(Evaluation, MatchesIndependentCalculation) {
  const std::filesystem::path shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const std::filesystem::path folder = shared / "cases" / "evaluate-times";
  const auto estimated = load_trajectory(folder / "estimate-30Hz.tum");
  ASSERT_TRUE(estimated) << estimated.error().message;
  const auto truth = load_trajectory(folder / "truth-100Hz.tum");
  ASSERT_TRUE(truth) << truth.error().message;
  const Evaluation e = evaluate(test::pinhole_camera(), *estimated, *truth);
  EXPECT_EQ(e.frames_estimated, 20);
  EXPECT_EQ(e.frames_judged, 20);
  EXPECT_NEAR(e.translation_mm.rmse, 0.025489604531, 1e-9);
  EXPECT_NEAR(e.rotation_deg.rmse, 0.023888263930, 1e-9);
}

TEST(Evaluation, MeasuresRotationForEitherQuaternionSign) {
  Trajectory truth;
  Trajectory estimated;
  truth.poses.push_back({0, above(0, 0, 1.0), {}});
  const CameraPose turned =
      above(0, 0, 1.0) * Transform<frame::Camera, frame::Camera>(
                             Eigen::Quaterniond(Eigen::AngleAxisd(std::numbers::pi / 180.0,
                                                                  Eigen::Vector3d(1, 2, 2) / 3.0)),
                             Eigen::Vector3d::Zero());
  // Adds the same rotation with the quaternion's sign flipped.
  estimated.poses.push_back(
      {0, CameraPose(Eigen::Quaterniond(-turned.rotation().coeffs()), turned.translation()), {}});
  EXPECT_NEAR(evaluate(test::pinhole_camera(), estimated, truth).rotation_deg.max, 1.0, 1e-9);
}

TEST(Evaluation, PredictsOverlayErrorOfCovarianceSamples) {
  CameraParameters p = test::pinhole_camera().parameters();
  p.distortion = {-0.215, 0.062, 0.0008, -0.0006, -0.004};
  const CameraModel camera = CameraModel::make(p).value();
  const CameraPose looking_down(Eigen::Quaterniond(0.1, 0.98, 0.05, -0.1),
                                Eigen::Vector3d(0.05, -0.03, 0.8));
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  Eigen::Matrix<double, 6, 6> root;
  for (int i = 0; i < 36; ++i) root(i / 6, i % 6) = 1e-4 * normal(random);
  root.topRows<3>() *= 3.0;
  const Eigen::Matrix<double, 6, 6> covariance = root * root.transpose();
  const double expected = predicted_overlay_error_px(camera, looking_down, covariance);
  double sum = 0.0;
  constexpr int kTrials = 20000;
  for (int i = 0; i < kTrials; ++i) {
    Eigen::Matrix<double, 6, 1> z;
    for (int j = 0; j < 6; ++j) z[j] = normal(random);
    const Eigen::Matrix<double, 6, 1> xi = root * z;
    const double angle = xi.tail<3>().norm();
    const Transform<frame::Camera, frame::Camera> step(
        Eigen::Quaterniond(Eigen::AngleAxisd(angle, xi.tail<3>() / angle)), xi.head<3>());
    const double error = overlay_difference(camera, looking_down * step, looking_down).rms_px();
    sum += error * error;
  }
  EXPECT_NEAR(std::sqrt(sum / kTrials) / expected, 1.0, 0.02);
  // The error of a corner increases as the corner approaches the camera's plane, even outside the
  // lens's valid range.
  double before = 0.0;
  for (const double depth : {0.1, 0.03, 0.01, 0.003, 0.001, 0.0003}) {
    const CameraPose near(Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0),
                          Eigen::Vector3d(0.02, 0.01, 0.2 + depth));
    const double here = predicted_overlay_error_px(camera, near, covariance);
    EXPECT_GT(here, before);
    before = here;
  }
  EXPECT_GT(before, 1e4 * expected);
  // A camera that looks away shows no overlay, so its error is unbounded.
  EXPECT_TRUE(std::isinf(predicted_overlay_error_px(camera, above(0, 0, -1.0), covariance)));
}

}  // namespace
}  // namespace penumbra
