// Estimation of the camera's velocity together with its pose, from rows that are read one after
// another.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <random>
#include <utility>

#include "core/evaluation/evaluation.hpp"
#include "support/paths.hpp"
#include "support/random_session.hpp"
#include "support/replay_tracking.hpp"
#include "support/synthetic_board.hpp"
#include "support/synthetic_view.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/group_tracker.hpp"
#include "tracking/motion/motion_model.hpp"

namespace penumbra {
namespace {

using test::board;
using test::displaced;
using test::loose_prior;
using test::random_view;

constexpr double kRow_s = 4e-5;

CameraModel with_row_time(double row_s) {
  CameraParameters p = test::lens_camera(test::Lens::plumb_bob, 640, 480, 0.85).parameters();
  p.tone_curve = 1.0;
  if (row_s > 0.0) p.rolling_shutter_row_s = row_s;
  return CameraModel::make(p).value();
}

class RollingShutter : public ::testing::Test {
 protected:
  // Renders rows of a camera with constant velocity and acceleration. `truth`: at the middle row.
  GreyImage rolling_image(PatternRenderer& renderer, const CameraPose& truth,
                          const Vector6d& velocity,
                          const Vector6d& acceleration = Vector6d::Zero()) {
    constexpr int kStrip = 4;
    PatternRenderOptions render;
    render.noise_grey = 2.0;
    render.samples = 96;
    render.seed = ++seed_;
    GreyImage image;
    for (int row = 0; row < camera_.height(); row += kStrip) {
      const double t = kRow_s * (row + 0.5 * (kStrip - camera_.height()));
      render.first_row = row;
      render.end_row = row + kStrip;
      const std::array<CameraPose, 1> path = {
          perturbed(truth, t * velocity + 0.5 * t * t * acceleration)};
      const GreyImage part = renderer.render(path, render);
      if (row == 0) image = part;
      const auto begin = static_cast<std::ptrdiff_t>(row) * image.width;
      std::copy_n(part.pixels.begin() + begin, kStrip * image.width, image.pixels.begin() + begin);
    }
    return image;
  }
  Vector6d random_velocity(double linear_m_s, double angular_rad_s) {
    std::normal_distribution<double> normal;
    Vector6d velocity;
    for (int k = 0; k < 6; ++k)
      velocity[k] = (k < 3 ? linear_m_s : angular_rad_s) * normal(random_);
    return velocity;
  }
  // An input whose velocity is unknown, and whose pose is off by some pixels.
  AlignmentInput input_of(const GreyImage& image, const CameraPose& truth) {
    AlignmentInput input;
    input.luma = image.view();
    input.predicted = as_map_pose(displaced(camera_, tags_, truth, 2.0, random_));
    input.covariance = loose_prior(0.003, 0.005);
    input.velocity_prior = unknown_velocity();
    return input;
  }
  double overlay_px(const MapFromCamera& estimated, const CameraPose& truth) const {
    return overlay_difference(camera_, estimated, as_map_pose(truth)).rms_px();
  }

  const CameraModel camera_ = with_row_time(kRow_s);
  const std::vector<MappedTag> tags_ = board(4, 3, 0.05);
  PatternRenderer renderer_ = PatternRenderer::create(camera_, tags_).value();
  std::mt19937_64 random_{11};
  std::uint64_t seed_ = 0;
};

TEST_F(RollingShutter, SolvesForPoseAndVelocityOfOneFrame) {
  auto aligner = TagAligner::create(camera_, tags_).value();
  double solved2 = 0.0;
  double ignored2 = 0.0;
  double normalised2 = 0.0;
  constexpr int kViews = 8;
  for (int k = 0; k < kViews; ++k) {
    const CameraPose truth = random_view(random_);
    const Vector6d velocity = random_velocity(0.2, 0.7);
    const GreyImage image = rolling_image(renderer_, truth, velocity);
    AlignmentInput input = input_of(image, truth);
    const AlignmentResult found = aligner.align(input);
    ASSERT_TRUE(found.verified) << found.reason;
    ASSERT_TRUE(found.velocity.has_value());
    solved2 += std::pow(overlay_px(found.T_map_camera, truth), 2) / kViews;
    const Vector6d off = found.velocity->velocity - velocity;
    normalised2 += off.dot(found.velocity->covariance.ldlt().solve(off)) / (6 * kViews);
    EXPECT_GT(Eigen::SelfAdjointEigenSolver<Matrix6d>(found.covariance).eigenvalues()[0], 0.0);
    input.velocity_prior.reset();
    const AlignmentResult without = aligner.align(input);
    ASSERT_TRUE(without.verified) << without.reason;
    EXPECT_FALSE(without.velocity.has_value());
    ignored2 += std::pow(overlay_px(without.T_map_camera, truth), 2) / kViews;
  }
  RecordProperty("solved_px", std::to_string(std::sqrt(solved2)));
  RecordProperty("ignored_px", std::to_string(std::sqrt(ignored2)));
  RecordProperty("velocity_nees", std::to_string(normalised2));
  EXPECT_LT(std::sqrt(solved2), 0.3 * std::sqrt(ignored2));
  EXPECT_LT(normalised2, 3.0) << "the covariance of the velocity is too small";
}

// A known velocity and a solved one have the same minimum if the prior is exact.
TEST_F(RollingShutter, AgreesWithKnownVelocityIfPriorIsNarrow) {
  auto aligner = TagAligner::create(camera_, tags_).value();
  for (int k = 0; k < 3; ++k) {
    const CameraPose truth = random_view(random_);
    const Vector6d velocity = random_velocity(0.2, 0.7);
    const GreyImage image = rolling_image(renderer_, truth, velocity);
    AlignmentInput input = input_of(image, truth);
    input.velocity = velocity;
    input.velocity_prior = VelocityPrior{covariance_of(1e-5, 1e-5)};
    const AlignmentResult solved = aligner.align(input);
    input.velocity_prior.reset();
    const AlignmentResult known = aligner.align(input);
    ASSERT_TRUE(solved.verified && known.verified);
    // The unknown acceleration remains.
    EXPECT_LT(overlay_difference(camera_, solved.T_map_camera, known.T_map_camera).rms_px(), 0.1);
    EXPECT_LT((solved.velocity->velocity - velocity).norm(), 1e-4);
    // It also reads more pixels.
    EXPECT_GT(solved.covariance.trace(), 0.45 * known.covariance.trace());
  }
}

TEST_F(RollingShutter, FindsNoMotionOfRestingCamera) {
  auto aligner = TagAligner::create(camera_, tags_).value();
  for (int k = 0; k < 3; ++k) {
    const CameraPose truth = random_view(random_);
    const GreyImage image = rolling_image(renderer_, truth, Vector6d::Zero());
    AlignmentInput input = input_of(image, truth);
    input.velocity_prior = VelocityPrior{covariance_of(0.02, 0.1)};
    const AlignmentResult found = aligner.align(input);
    ASSERT_TRUE(found.verified) << found.reason;
    const double predicted_px =
        predicted_overlay_error_px(camera_, found.T_map_camera, found.covariance);
    EXPECT_LT(overlay_px(found.T_map_camera, truth), 3.0 * predicted_px);
    EXPECT_LT(found.velocity->velocity.head<3>().norm(), 0.05);
    EXPECT_LT(found.velocity->velocity.tail<3>().norm(), 0.2);
  }
}

// One tag hardly determines a velocity, so the prior does.
TEST_F(RollingShutter, KeepsPriorOfVelocityForSingleTag) {
  const std::vector<MappedTag> tag = {test::flat_tag(3, 0.0, 0.0, 0.08)};
  PatternRenderer renderer = PatternRenderer::create(camera_, tag).value();
  auto aligner = TagAligner::create(camera_, tag).value();
  for (int k = 0; k < 4; ++k) {
    const CameraPose truth = random_view(random_);
    const Vector6d velocity = random_velocity(0.2, 0.7);
    const GreyImage image = rolling_image(renderer, truth, velocity);
    AlignmentInput input = input_of(image, truth);
    input.velocity = velocity + random_velocity(0.02, 0.1);
    input.velocity_prior = VelocityPrior{covariance_of(0.02, 0.1)};
    const AlignmentResult found = aligner.align(input);
    ASSERT_TRUE(found.verified) << found.reason;
    const Vector6d change = found.velocity->velocity - input.velocity;
    EXPECT_LT(change.head<3>().norm(), 0.02);
    EXPECT_LT(change.tail<3>().norm(), 0.1);
    const double uncertain = found.velocity->covariance.trace() / covariance_of(0.02, 0.1).trace();
    EXPECT_GT(uncertain, 0.5) << "only the shear within the tag adds to the prior";
    EXPECT_LE(uncertain, 1.0 + 1e-9);
    // The uncertainty of the velocity is part of the pose's.
    input.velocity_prior.reset();
    const AlignmentResult known = aligner.align(input);
    EXPECT_GT(found.covariance.trace(), known.covariance.trace());
  }
}

// Returns the results with the input's prior of the velocity and without it.
std::pair<AlignmentResult, AlignmentResult> aligned_with_and_without_prior(TagAligner& aligner,
                                                                           AlignmentInput input) {
  AlignmentResult with = aligner.align(input);
  input.velocity_prior.reset();
  return {std::move(with), aligner.align(input)};
}

TEST_F(RollingShutter, ImprovesPoseDespiteWrongRowTime) {
  for (const double factor : {0.5, 2.0}) {
    SCOPED_TRACE(factor);
    auto aligner = TagAligner::create(with_row_time(factor * kRow_s), tags_).value();
    double with2 = 0.0;
    double without2 = 0.0;
    for (int k = 0; k < 4; ++k) {
      const CameraPose truth = random_view(random_);
      const GreyImage image = rolling_image(renderer_, truth, random_velocity(0.1, 0.4));
      const auto [with, without] = aligned_with_and_without_prior(aligner, input_of(image, truth));
      ASSERT_TRUE(with.verified && without.verified);
      with2 += std::pow(overlay_px(with.T_map_camera, truth), 2);
      without2 += std::pow(overlay_px(without.T_map_camera, truth), 2);
    }
    EXPECT_LT(std::sqrt(with2), 0.6 * std::sqrt(without2));
  }
}

// The prior of the velocity must not matter to a camera whose rows are exposed at once.
TEST_F(RollingShutter, IsInertWithoutRowTime) {
  auto aligner = TagAligner::create(with_row_time(0.0), tags_).value();
  for (int k = 0; k < 3; ++k) {
    const CameraPose truth = random_view(random_);
    const GreyImage image = rolling_image(renderer_, truth, random_velocity(0.1, 0.4));
    const auto [with, without] = aligned_with_and_without_prior(aligner, input_of(image, truth));
    EXPECT_FALSE(with.velocity.has_value());
    EXPECT_TRUE(with.T_map_camera.matrix() == without.T_map_camera.matrix());
    EXPECT_TRUE(with.covariance == without.covariance);
  }
}

TEST_F(RollingShutter, ReturnsFiniteNumbersForExtremeInput) {
  auto aligner = TagAligner::create(camera_, tags_).value();
  const CameraPose truth = random_view(random_);
  const GreyImage image = rolling_image(renderer_, truth, random_velocity(0.2, 0.7));
  for (const double speed : {1e-300, 1.0, 30.0, 1e4}) {
    for (const double sigma : {1e-9, 1.0, 1e6}) {
      for (const bool blank : {false, true}) {
        SCOPED_TRACE(testing::Message() << speed << ' ' << sigma << ' ' << blank);
        GreyImage seen = image;
        if (blank) std::ranges::fill(seen.pixels, std::uint8_t{90});
        AlignmentInput input = input_of(seen, truth);
        input.velocity.setConstant(speed);
        input.velocity_prior = VelocityPrior{covariance_of(sigma, sigma)};
        // More correlated than possible.
        input.velocity_prior->cross_covariance.setConstant(sigma);
        const AlignmentResult found = aligner.align(input);
        if (!found.verified) continue;
        EXPECT_TRUE(found.T_map_camera.is_finite());
        EXPECT_TRUE(found.covariance.allFinite());
        EXPECT_TRUE(found.velocity->velocity.allFinite());
        EXPECT_TRUE(found.velocity->covariance.allFinite());
      }
    }
  }
}

// Accelerations between the frames of a hand-held camera, as in quick pans.
TEST_F(RollingShutter, TracksAcceleratingHandWithConsistentError) {
  test::Session session;
  session.camera = camera_;
  session.tags = tags_;
  session.motion.distance = {0.45, 0.03, 1.9, 0.3};
  session.motion.elevation = {1.0, 0.04, 3.1, 1.0};
  session.motion.azimuth = {0.4, 0.06, 2.8, 2.0};
  session.motion.x = {0.0, 0.02, 3.3, 0.0};
  session.motion.y = {0.0, 0.02, 2.6, 1.5};
  session.light.noise_grey = 2.0;
  session.light.samples = 32;
  const TagMap map = TagMap::make(tags_).value();
  for (const TrackingMode mode : {TrackingMode::fast, TrackingMode::accurate}) {
    TrackerOptions options;
    options.mode = mode;
    auto tracker = GroupTracker::create(camera_, map, options).value();
    auto ignorant = GroupTracker::create(with_row_time(0.0), map, options).value();
    double error2 = 0.0;
    double ignorant2 = 0.0;
    constexpr int kFrames = 14;
    for (int i = 0; i < kFrames; ++i) {
      const Frame frame = session.image(renderer_, i);
      const PoseEstimate found = tracker.track(frame).pose;
      const PoseEstimate other = ignorant.track(frame).pose;
      ASSERT_TRUE(found.has_pose()) << i << ": " << text_of(found.reason);
      ASSERT_TRUE(other.has_pose()) << i << ": " << text_of(other.reason);
      if (i == 0) continue;  // from detected corners, which ignore the rows
      const auto error_px = [&](const PoseEstimate& pose) {
        return overlay_difference(camera_, pose.T_table_camera, session.truth(i)).rms_px();
      };
      EXPECT_LT(error_px(found), 3.5 * found.predicted_overlay_error_px) << i;
      error2 += std::pow(error_px(found), 2) / (kFrames - 1);
      ignorant2 += std::pow(error_px(other), 2) / (kFrames - 1);
    }
    RecordProperty("solved_px", std::to_string(std::sqrt(error2)));
    RecordProperty("ignored_px", std::to_string(std::sqrt(ignorant2)));
    EXPECT_LT(std::sqrt(error2), 0.3 * std::sqrt(ignorant2));
  }
}

// The ray-traced recording `rolling`, with its true row time.
class RollingRecording : public ::testing::TestWithParam<TrackingMode> {};

TEST_P(RollingRecording, IsTrackedWithConsistentError) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  auto session = test::load_session(test::shared_dir() / "recordings" / "rolling").value();
  CameraParameters p = session.camera.parameters();
  p.rolling_shutter_row_s = kRow_s;
  session.camera = CameraModel::make(p).value();
  TrackerOptions options;
  options.mode = GetParam();
  auto trial = test::TrackingTrial::create(session, session.tags, options).value();
  for (const test::ListedFrame& listed : session.listed)
    trial.add(test::load_frame_image(listed).value());
  const test::TrackedRecording tracked = trial.result();
  ASSERT_EQ(tracked.count_of(TrackStatus::tracked), static_cast<int>(session.listed.size()));
  std::vector<double> ratios;
  double error2 = 0.0;
  for (std::size_t i = 0; i < tracked.frames.size(); ++i) {
    error2 += tracked.overlay_px[i] * tracked.overlay_px[i];
    ratios.push_back(tracked.overlay_px[i] / tracked.frames[i].pose.predicted_overlay_error_px);
  }
  const auto count = static_cast<double>(ratios.size());
  std::ranges::sort(ratios);
  RecordProperty("overlay_px", std::to_string(std::sqrt(error2 / count)));
  RecordProperty("median_ratio", std::to_string(ratios[ratios.size() / 2]));
  RecordProperty("max_ratio", std::to_string(ratios.back()));
  EXPECT_LT(std::sqrt(error2 / count), 0.33);
  EXPECT_LT(ratios[ratios.size() / 2], 1.2);
  EXPECT_LT(ratios.back(), 3.0);
}

INSTANTIATE_TEST_SUITE_P(Modes, RollingRecording,
                         testing::Values(TrackingMode::fast, TrackingMode::automatic,
                                         TrackingMode::accurate),
                         [](const auto& mode) {
                           return std::string(name_of(kTrackingModeNames, mode.param));
                         });

TEST(MotionModel, BoundsPriorOfVelocityByHandMotion) {
  constexpr std::int64_t kFrame_ns = 33'333'333;
  MotionModel motion;
  const MapFromCamera pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.0, 0.0, 0.5));
  motion.start(0, pose, covariance_of(2e-4, 5e-4));
  for (int k = 1; k <= 200; ++k) {
    const VelocityPrior prior = motion.velocity_prior(k * kFrame_ns);
    const MotionPrediction prediction = motion.predict(k * kFrame_ns);
    Eigen::Matrix<double, 12, 12> joint;
    joint << prediction.covariance, prior.cross_covariance.transpose(), prior.cross_covariance,
        prior.covariance;
    EXPECT_EQ(joint.llt().info(), Eigen::Success) << k;
    // The velocity if the pose is known.
    const Matrix6d known = prior.covariance - prior.cross_covariance *
                                                  prediction.covariance.inverse() *
                                                  prior.cross_covariance.transpose();
    for (int i = 0; i < 6; ++i) {
      const double sigma = std::sqrt(known(i, i));
      EXPECT_GT(sigma, i < 3 ? 0.005 : 0.02) << k;
      EXPECT_LT(sigma, i < 3 ? 0.15 : 1.0) << k;
    }
    motion.update(k * kFrame_ns, pose, covariance_of(2e-4, 5e-4));
  }
}

}  // namespace
}  // namespace penumbra
