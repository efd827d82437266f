#include "app/session/pose_smoother.hpp"

#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <rapidcheck/gtest.h>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "core/evaluation/evaluation.hpp"
#include "core/units.hpp"
#include "support/cameras.hpp"
#include "support/random_session.hpp"

namespace penumbra {
namespace {

using test::desk_camera;
using test::looking_at;
using test::RandomNumbers;

constexpr double kFrame_s = 1.0 / 30.0;

CameraPose rest_pose() {
  return looking_at({0.0, 0.0, 0.0}, 0.6, 0.9, 0.3, 0.1);
}

// Returns the lag [ms] of the drawn poses from index `first` on.
std::optional<double> lag_ms(const Trajectory& measured, const Trajectory& drawn,
                             std::size_t first = 0) {
  LagMeter meter(desk_camera());
  for (std::size_t i = first; i < measured.poses.size(); ++i) {
    meter.add(measured.poses[i].timestamp_ns, measured.poses[i].T_table_camera,
              drawn.poses[i].T_table_camera);
  }
  return meter.lag_ms();
}

double overlay_distance_px(const CameraPose& a, const CameraPose& b) {
  return overlay_difference(desk_camera(), a, b).rms_px();
}

// Returns the rest pose shifted to the right, so that the overlay moves by about `px`.
CameraPose shifted(double px) {
  Vector6d xi = Vector6d::Zero();
  xi[0] = 1e-3;
  const double px_per_mm = overlay_distance_px(perturbed(rest_pose(), xi), rest_pose());
  xi[0] *= px / px_per_mm;
  return perturbed(rest_pose(), xi);
}

// Jitter [px] before and after smoothing noisy poses of a camera at rest.
struct Jitter {
  Evaluation before, after;
};
Jitter jitter_at_rest(double noise) {
  PoseSmoother smoother(desk_camera());
  RandomNumbers draw(1);
  Trajectory measured, drawn, truth;
  for (int i = 0; i < 300; ++i) {
    Vector6d xi;
    for (int k = 0; k < 6; ++k) xi[k] = noise * (draw() + draw() + draw() - 1.5);
    const std::int64_t at = nanoseconds(1.0 + i * kFrame_s);
    const CameraPose pose = perturbed(rest_pose(), xi);
    const SmoothedPose smoothed = smoother.smooth(at, pose);
    if (i < 30) continue;  // the first poses are not smoothed yet
    measured.poses.push_back({at, pose, {}});
    drawn.poses.push_back({at, smoothed.T_table_camera, {}});
    truth.poses.push_back({at, rest_pose(), {}});
  }
  return {evaluate(desk_camera(), measured, truth), evaluate(desk_camera(), drawn, truth)};
}

TEST(PoseSmoother, ReducesJitterAtRest) {
  const auto [before, after] = jitter_at_rest(3e-5);  // the tracker's typical noise
  EXPECT_GT(before.jitter_px, 0.03) << "the input must have jitter";
  EXPECT_LT(after.jitter_px, before.jitter_px / 5.0);
  EXPECT_LT(after.overlay_px.rmse, before.overlay_px.rmse / 2.0);
  // Three times the noise raises the cutoff somewhat.
  const auto [noisy, smoothed] = jitter_at_rest(1e-4);
  EXPECT_LT(smoothed.jitter_px, noisy.jitter_px / 4.0);
  EXPECT_LT(smoothed.overlay_px.rmse, noisy.overlay_px.rmse / 2.0);
}

TEST(PoseSmoother, ReportsLagOfSteadyMotionAndBoundsOffset) {
  for (const double px_s : {0.1, 0.3, 1.0, 3.0, 10.0, 100.0, 1000.0}) {
    SCOPED_TRACE(px_s);
    PoseSmoother smoother(desk_camera());
    Trajectory measured, drawn;
    SmoothedPose last;
    // Limits the motion to the image's middle, where a shift moves the whole overlay evenly.
    const int frames = px_s > 100.0 ? 30 : 90;
    for (int i = 0; i < frames; ++i) {
      const std::int64_t at = nanoseconds(1.0 + i * kFrame_s);
      const CameraPose pose = shifted(px_s * kFrame_s * (i - frames));
      last = smoother.smooth(at, pose);
      measured.poses.push_back({at, pose, {}});
      drawn.poses.push_back({at, last.T_table_camera, {}});
    }
    const double cutoff = 1.0 + px_s * px_s;
    EXPECT_NEAR(last.lag_ms, 1e3 / (2.0 * std::numbers::pi * cutoff), 0.05 * last.lag_ms);
    EXPECT_NEAR(last.offset_px, px_s * 1e-3 * last.lag_ms, 0.05 * last.offset_px);
    EXPECT_LT(last.offset_px, 0.5 / (2.0 * std::numbers::pi) * 1.05);
    // The drawn pose lags: it is closer to the previous poses than the measured pose is.
    EXPECT_LT(overlay_distance_px(last.T_table_camera, shifted(-px_s)),
              overlay_distance_px(measured.poses.back().T_table_camera, shifted(-px_s)));
    ASSERT_EQ(lag_ms(measured, drawn).has_value(), px_s > 5.0);
    if (px_s == 10.0) {
      // The filter estimates the speed only after some frames.
      EXPECT_NEAR(lag_ms(measured, drawn, 45).value(), last.lag_ms, 0.05 * last.lag_ms);
    }
  }
}

TEST(PoseSmoother, MeasuresLagOfDelayedPath) {
  Trajectory measured, drawn;
  for (int i = 0; i < 60; ++i) {
    const std::int64_t at = nanoseconds(1.0 + i * kFrame_s);
    const auto path_pose = [](double t) { return shifted(60.0 * std::sin(3.0 * t)); };
    measured.poses.push_back({at, path_pose(i * kFrame_s), {}});
    drawn.poses.push_back({at, path_pose(i * kFrame_s - 0.012), {}});
  }
  EXPECT_NEAR(lag_ms(measured, drawn).value(), 12.0, 0.5);
  EXPECT_NEAR(lag_ms(measured, measured).value(), 0.0, 1e-9);
}

TEST(PoseSmoother, FollowsJumpWithoutOvershoot) {
  for (const double jump_px : {0.5, 5.0, 50.0, 200.0}) {
    SCOPED_TRACE(jump_px);
    PoseSmoother smoother(desk_camera());
    int frame = 0;
    const auto draw = [&](const CameraPose& pose) {
      return smoother.smooth(nanoseconds(1.0 + frame++ * kFrame_s), pose);
    };
    for (int i = 0; i < 30; ++i) (void)draw(shifted(0.0));
    double before = jump_px;
    for (int i = 0; i < 60; ++i) {
      const SmoothedPose drawn = draw(shifted(jump_px));
      EXPECT_LE(drawn.offset_px, PoseSmoother::kMaxOffset_px);
      EXPECT_LE(drawn.offset_px, before + 1e-9) << "the offset must never grow";
      EXPECT_LE(overlay_distance_px(drawn.T_table_camera, shifted(0.0)),
                overlay_distance_px(shifted(jump_px), shifted(0.0)) + 1e-9)
          << "the drawn pose must not overshoot";
      before = drawn.offset_px;
    }
    EXPECT_LT(before, 0.01);
  }
}

TEST(PoseSmoother, RestartsAfterLossGapAndBackwardTime) {
  const CameraPose a = shifted(0.0);
  const CameraPose b = shifted(0.1);  // within the offset bound, so the drawn pose may differ
  const std::int64_t second = 1'000'000'000;
  const auto expect_as_measured = [&](const SmoothedPose& drawn) {
    EXPECT_EQ(drawn.T_table_camera.matrix(), b.matrix());
    EXPECT_EQ(drawn.lag_ms, 0.0);
    EXPECT_EQ(drawn.offset_px, 0.0);
  };
  PoseSmoother smoother(desk_camera());
  (void)smoother.smooth(second, a);
  EXPECT_GT(smoother.smooth(second + 33'000'000, b).offset_px, 0.05)
      << "without a reset, smoothing must continue";

  smoother.reset();
  expect_as_measured(smoother.smooth(second + 66'000'000, b));
  (void)smoother.smooth(second + 99'000'000, a);
  expect_as_measured(smoother.smooth(2 * second, b));
  (void)smoother.smooth(2 * second + 33'000'000, a);
  expect_as_measured(smoother.smooth(2 * second, b));
}

TEST(PoseSmoother, ReturnsSamePoseForRepeatedFrame) {
  PoseSmoother smoother(desk_camera());
  (void)smoother.smooth(0, shifted(0.0));
  const SmoothedPose first = smoother.smooth(33'000'000, shifted(0.1));
  for (int i = 0; i < 3; ++i) {
    const SmoothedPose again = smoother.smooth(33'000'000, shifted(0.1));
    EXPECT_EQ(again.T_table_camera.matrix(), first.T_table_camera.matrix());
    EXPECT_EQ(again.offset_px, first.offset_px);
    EXPECT_EQ(again.lag_ms, first.lag_ms);
  }
}

// A random walk of the camera with jumps, at uneven or repeated times.
RC_GTEST_PROP(PoseSmoother, StaysWithinBoundsForAnyMotionAndTimes, ()) {
  RandomNumbers draw(*rc::gen::arbitrary<std::uint64_t>());
  const CameraModel camera = desk_camera();
  PoseSmoother smoother(camera);
  std::int64_t at = draw.below(1000) * std::int64_t{1'000'000};
  CameraPose pose = looking_at({0.0, 0.0, 0.0}, draw.between(0.2, 1.5), draw.between(0.1, 1.5),
                               draw.between(0.0, 6.28), draw.between(-0.5, 0.5));
  CameraPose before = smoother.smooth(at, pose).T_table_camera;
  const double size = draw.log_between(1e-6, 0.1);
  for (int i = 0; i < 40; ++i) {
    const double kind = draw();
    if (kind > 0.2) at += static_cast<std::int64_t>(draw.log_between(1.0, 4e8));
    const double step = kind > 0.9 ? 0.3 : size;
    Vector6d xi;
    for (int k = 0; k < 6; ++k) xi[k] = step * draw.between(-1.0, 1.0);
    pose = perturbed(pose, xi);
    const SmoothedPose drawn = smoother.smooth(at, pose);
    RC_ASSERT(drawn.T_table_camera.is_finite());
    RC_ASSERT(std::isfinite(drawn.lag_ms) && drawn.lag_ms >= 0.0);
    RC_ASSERT(drawn.offset_px >= 0.0 && drawn.offset_px <= PoseSmoother::kMaxOffset_px);
    // Maximum lag, at the minimum cutoff of 1 Hz: 1 / (2 pi 1 Hz).
    RC_ASSERT(drawn.lag_ms <= 160.0);
    const Vector6d measured_change = perturbation_between(before, pose);
    const Vector6d drawn_change = perturbation_between(before, drawn.T_table_camera);
    const Vector6d remaining = perturbation_between(drawn.T_table_camera, pose);
    for (const auto begin : {0, 3}) {
      const double measured_norm = measured_change.segment<3>(begin).norm();
      RC_ASSERT(drawn_change.segment<3>(begin).norm() <= measured_norm * (1.0 + 1e-6) + 1e-9);
      RC_ASSERT(remaining.segment<3>(begin).norm() <= measured_norm * (1.0 + 1e-6) + 1e-9);
    }
    before = drawn.T_table_camera;
  }
}

// Numbers of any magnitude, as a failing tracker may produce them.
RC_GTEST_PROP(PoseSmoother, ReturnsFinitePosesForFiniteInput, ()) {
  RandomNumbers draw(*rc::gen::arbitrary<std::uint64_t>());
  PoseSmoother smoother(desk_camera());
  const double huge = std::numeric_limits<double>::max();
  for (int i = 0; i < 20; ++i) {
    const auto number = [&] {
      const double kind = draw();
      const double sign = draw() < 0.5 ? -1.0 : 1.0;
      return kind < 0.1   ? 0.0
             : kind < 0.2 ? sign * huge
                          : sign * std::pow(10.0, draw.between(-300.0, 300.0));
    };
    const CameraPose pose(
        Eigen::Quaterniond(draw.between(-1.0, 1.0), draw.between(-1.0, 1.0),
                           draw.between(-1.0, 1.0), draw.between(0.1, 1.0)),
        draw() < 0.3 ? rest_pose().translation() : Eigen::Vector3d(number(), number(), number()));
    const double kind = draw();
    const std::int64_t at = kind < 0.1   ? std::numeric_limits<std::int64_t>::min()
                            : kind < 0.2 ? std::numeric_limits<std::int64_t>::max()
                            : kind < 0.4 ? i
                                         : static_cast<std::int64_t>(draw.log_between(1.0, 9e18));
    const SmoothedPose drawn = smoother.smooth(at, pose);
    RC_ASSERT(pose.is_finite());
    RC_ASSERT(drawn.T_table_camera.is_finite());
    RC_ASSERT(std::isfinite(drawn.lag_ms) && std::isfinite(drawn.offset_px));
    RC_ASSERT(drawn.offset_px <= PoseSmoother::kMaxOffset_px);
  }
}

TEST(PoseSmoother, PassesNonFinitePoseThroughAndRestarts) {
  PoseSmoother smoother(desk_camera());
  (void)smoother.smooth(0, shifted(0.0));
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const CameraPose bad(Eigen::Quaterniond::Identity(), Eigen::Vector3d(nan, 0.0, 0.0));
  EXPECT_FALSE(smoother.smooth(33'000'000, bad).T_table_camera.is_finite());
  EXPECT_EQ(smoother.smooth(66'000'000, shifted(0.1)).T_table_camera.matrix(),
            shifted(0.1).matrix());
}

}  // namespace
}  // namespace penumbra
