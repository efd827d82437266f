#include "tracking/motion/motion_blur.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "support/random_session.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

TEST(SharpResiduals, CountsWholeResidualUntilImagesWereSeen) {
  SharpResiduals residuals;
  for (int i = 0; i < 7; ++i) {
    EXPECT_EQ(residuals.excess_px(0.2), 0.2) << i;
    residuals.add(0.2);
  }
  residuals.add(0.2);
  EXPECT_EQ(residuals.excess_px(0.2), 0.0);
}

TEST(SharpResiduals, CountsWhatSharpImagesDoNotHave) {
  SharpResiduals residuals;
  for (const double rms_px : {0.4, 0.3, 0.2, 0.5, 0.4, 0.3, 0.6, 0.4}) residuals.add(rms_px);
  EXPECT_EQ(residuals.excess_px(0.24), 0.0);
  EXPECT_NEAR(residuals.excess_px(0.3), std::sqrt(0.3 * 0.3 - 0.24 * 0.24), 1e-12);
  EXPECT_NEAR(residuals.excess_px(2.4), 2.4, 0.02);
}

TEST(SharpResiduals, IsFiniteForExtremeResiduals) {
  SharpResiduals residuals;
  for (int i = 0; i < 20; ++i) {
    for (const double rms_px : {0.0, -1.0, kNaN, kInfinity, 1e300, 1e-300}) residuals.add(rms_px);
  }
  for (const double rms_px : {0.0, 1e-300, 0.2, 1e150}) {
    const double excess_px = residuals.excess_px(rms_px);
    EXPECT_GE(excess_px, 0.0) << rms_px;
    EXPECT_LE(excess_px, rms_px) << rms_px;
  }
  EXPECT_TRUE(std::isnan(residuals.excess_px(kNaN)));
}

TEST(ExposureFractions, AreThoseOfKnownExposure) {
  Frame frame;
  frame.exposure_s = 0.01;
  EXPECT_NEAR(exposure_of(frame, 1.0 / 60.0).of_interval, 0.6, 1e-12);
  EXPECT_NEAR(exposure_of(frame, 1.0 / 60.0).of_motion, 0.3, 1e-12);
  EXPECT_NEAR(exposure_of(frame, 0.0).of_interval, 0.3, 1e-12) << "unknown interval: 1/30 s";
  EXPECT_TRUE(exposure_of(frame, 0.0).known);
  frame.exposure_s = 0.1;
  EXPECT_EQ(exposure_of(frame, 1.0 / 30.0).of_interval, 1.0);
  EXPECT_NEAR(exposure_of(frame, 1.0 / 30.0).of_motion, 3.0, 1e-12);
  frame.exposure_s = 0.0;
  EXPECT_EQ(exposure_of(frame, 1.0 / 30.0).of_motion, 0.0);
}

TEST(ExposureFractions, AreUpperLimitsForUnknownExposure) {
  const Frame frame;
  EXPECT_FALSE(exposure_of(frame, 1.0 / 30.0).known);
  for (const double interval_s : {0.0, 1.0 / 30.0, 1.0 / 120.0})
    EXPECT_EQ(exposure_of(frame, interval_s).of_interval, 1.0) << interval_s;
  EXPECT_NEAR(exposure_of(frame, 1.0 / 120.0).of_motion, 0.25, 1e-12);
  // An exposure does not last longer if the frame interval does.
  EXPECT_NEAR(exposure_of(frame, 1.0 / 10.0).of_interval, 1.0 / 3.0, 1e-12);
  EXPECT_NEAR(exposure_of(frame, 1.0 / 10.0).of_motion, 1.0, 1e-12);
}

// Ratio of actual to predicted error of moving views, RMS over frames 8 to 19.
double rms_ratio(double exposure_s, double& predicted_px) {
  double squares = 0.0;
  int count = 0;
  predicted_px = 0.0;
  for (const std::uint64_t seed : {3U, 4U}) {
    test::RandomNumbers draw(seed);
    test::Session session;
    session.camera = test::lens_camera(test::Lens::plumb_bob, 320, 240, 0.85);
    session.tags = test::layout_of(test::Layout::sheet, draw);
    session.motion = test::hand_motion(3, 0.6, 1.0, draw);
    session.exposure_s = exposure_s;
    session.light.noise_grey = 2.0;
    session.light.samples = 64;
    session.light.seed = seed;
    PatternRenderer renderer = PatternRenderer::create(session.camera, session.tags).value();
    GroupTracker tracker =
        GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
    for (int f = 0; f < 20; ++f) {
      const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
      EXPECT_TRUE(pose.has_pose()) << "seed " << seed << ", frame " << f;
      if (f < 8 || !pose.has_pose()) continue;
      const double error_px =
          overlay_difference(session.camera, pose.T_table_camera, session.truth(f)).rms_px();
      squares += std::pow(error_px / pose.predicted_overlay_error_px, 2);
      predicted_px += pose.predicted_overlay_error_px;
      ++count;
    }
  }
  predicted_px /= count;
  return std::sqrt(squares / count);
}

// Residuals of sharp images are no motion blur, however fast the view moves.
TEST(PredictedError, IsThatOfNoiseIfImagesAreSharp) {
  double sharp_px = 0.0;
  double blurred_px = 0.0;
  const double sharp = rms_ratio(0.0, sharp_px);
  const double blurred = rms_ratio(0.02, blurred_px);
  EXPECT_LT(sharp, 1.0) << sharp_px;
  EXPECT_GT(sharp, 0.2);
  EXPECT_LT(blurred, 1.0) << blurred_px;
  EXPECT_GT(blurred_px, sharp_px);
}

}  // namespace
}  // namespace penumbra
