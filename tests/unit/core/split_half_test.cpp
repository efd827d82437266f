#include "core/evaluation/split_half.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "core/evaluation/evaluation.hpp"
#include "support/cameras.hpp"

namespace penumbra {
namespace {

PoseEstimate tracked_at(double x_m, double sigma_m = 1e-3) {
  PoseEstimate pose;
  pose.status = TrackStatus::tracked;
  pose.tags_used = 6;
  pose.T_table_camera = {Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0), Eigen::Vector3d(x_m, 0.0, 0.8)};
  pose.covariance.diagonal().head<3>().setConstant(sigma_m * sigma_m);
  return pose;
}

TEST(SplitHalf, DividesDifferenceBySqrt2) {
  const CameraModel camera = test::pinhole_camera();
  const PoseEstimate a = tracked_at(0.0);
  const PoseEstimate b = tracked_at(0.004);
  const HalfDifference result = compare_halves(camera, 7, a, b);
  EXPECT_EQ(result.timestamp_ns, 7);
  ASSERT_FALSE(result.rejection);
  const double overlay_px = overlay_difference(camera, a.T_table_camera, b.T_table_camera).rms_px();
  EXPECT_NEAR(result.difference_px, overlay_px / std::numbers::sqrt2, 1e-12);
}

TEST(SplitHalf, CombinesPredictionsWithoutTheLens) {
  const PoseEstimate a = tracked_at(0.0, 1e-3);
  const PoseEstimate b = tracked_at(0.0, 3e-3);
  const double one_px =
      predicted_overlay_error_px(test::pinhole_camera(), a.T_table_camera, a.covariance);
  // sqrt((1 + 9) / 2) times the error of 1 mm.
  for (const std::optional<double> lens_px : {std::optional<double>(), std::optional(1.5)})
    EXPECT_NEAR(compare_halves(test::pinhole_camera(lens_px), 0, a, b).predicted_px,
                std::sqrt(5.0) * one_px, 1e-9);
}

TEST(SplitHalf, RejectsPosesThatCannotBeCompared) {
  const CameraModel camera = test::pinhole_camera();
  const auto rejection_of = [&](const auto& change) {
    PoseEstimate second = tracked_at(0.001);
    change(second);
    const auto one = compare_halves(camera, 0, tracked_at(0.0), second).rejection;
    EXPECT_EQ(one, compare_halves(camera, 0, second, tracked_at(0.0)).rejection);
    return one;
  };
  EXPECT_EQ(rejection_of([](PoseEstimate&) {}), std::nullopt);
  EXPECT_EQ(rejection_of([](PoseEstimate& p) { p.tags_used = 0; }), HalfRejection::not_measured);
  EXPECT_EQ(rejection_of([](PoseEstimate& p) { p.status = TrackStatus::uncertain; }),
            HalfRejection::uncertain);
  EXPECT_EQ(rejection_of([](PoseEstimate& p) {
              p.covariance.setConstant(std::numeric_limits<double>::quiet_NaN());
            }),
            HalfRejection::out_of_view);
  PoseEstimate few = tracked_at(0.0);
  few.tags_used = 1;
  EXPECT_EQ(compare_halves(camera, 0, few, few).rejection, HalfRejection::too_few_tags);
}

TEST(SplitHalf, CountsFramesAndRatios) {
  std::vector<HalfDifference> frames;
  for (int i = 1; i <= 8; ++i) frames.push_back({i, std::nullopt, 0.1 * i, 0.21});
  frames.push_back({9, HalfRejection::uncertain, 0.0, 0.0});
  frames.push_back({10, HalfRejection::not_measured, 0.0, 0.0});
  const SplitHalfErrors errors = split_half_errors(frames);
  EXPECT_EQ(errors.frames_compared, 8);
  EXPECT_THAT(errors.frames_rejected, testing::ElementsAre(0, 1, 1, 0));
  EXPECT_NEAR(errors.difference_px.median, 0.45, 1e-12);
  EXPECT_NEAR(errors.predicted_px.rmse, 0.21, 1e-12);
  EXPECT_NEAR(errors.ratio, errors.difference_px.rmse / 0.21, 1e-12);
  EXPECT_NEAR(errors.share_above_3, 2.0 / 8.0, 1e-12);  // 0.7 and 0.8 px
  EXPECT_EQ(split_half_errors({}).frames_compared, 0);
}

TEST(SplitHalf, MeasuresErrorOfOneHalfIfErrorsAreIndependent) {
  // Two poses with independent errors: the RMS difference over sqrt 2 is the RMS error of one.
  const CameraModel camera = test::pinhole_camera();
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal(0.0, 1e-3);
  std::vector<HalfDifference> frames;
  std::vector<double> actual;
  for (int i = 0; i < 4000; ++i) {
    PoseEstimate a = tracked_at(normal(random));
    PoseEstimate b = tracked_at(normal(random));
    for (PoseEstimate* pose : {&a, &b}) pose->covariance.diagonal() << 1e-6, 0, 0, 0, 0, 0;
    frames.push_back(compare_halves(camera, i, a, b));
    actual.push_back(
        overlay_difference(camera, a.T_table_camera, tracked_at(0.0).T_table_camera).rms_px());
  }
  const SplitHalfErrors errors = split_half_errors(frames);
  EXPECT_NEAR(errors.difference_px.rmse / statistics_of(actual).rmse, 1.0, 0.05);
  EXPECT_NEAR(errors.ratio, 1.0, 0.05);
}

}  // namespace
}  // namespace penumbra
