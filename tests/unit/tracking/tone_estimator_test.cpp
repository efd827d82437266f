#include "tracking/alignment/tone_estimator.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "core/evaluation/evaluation.hpp"
#include "support/cameras.hpp"
#include "support/synthetic_board.hpp"
#include "support/test_form.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra {
namespace {

using test::board;
using test::desk_camera;
using test::displaced;

constexpr int kImages = 6;

// Camera response: maps linear light to a pixel value, both from 0 to 1.
using Tone = std::function<double(double)>;
Tone power(double exponent) {
  return [exponent](double light) { return std::pow(light, 1.0 / exponent); };
}
double srgb(double light) {
  return light <= 0.0031308 ? 12.92 * light : 1.055 * std::pow(light, 1.0 / 2.4) - 0.055;
}

// Linear images of a board from several poses. Cameras with different responses share them.
class Views {
 public:
  Views(const PatternRenderOptions& options, int count, std::vector<MappedTag> tags)
      : tags_(std::move(tags)) {
    PatternRenderer renderer = PatternRenderer::create(camera_, tags_).value();
    std::mt19937_64 random(7);
    std::uniform_real_distribution<double> u(0.0, 1.0);
    for (int k = 0; k < count; ++k) {
      // Cells are 4 to 7 px wide.
      const double distance = 0.40 + 0.20 * u(random);
      const double elevation = radians(45.0 + 40.0 * u(random));
      const double azimuth = radians(360.0 * u(random));
      poses_.push_back(test::looking_at({0.02 * (u(random) - 0.5), 0.02 * (u(random) - 0.5), 0.0},
                                        distance, elevation, azimuth,
                                        radians(30.0 * (u(random) - 0.5))));
      const std::array<CameraPose, 1> path = {poses_.back()};
      light_.push_back(renderer.render_light(path, options));
      starts_.push_back(displaced(camera_, tags_, poses_.back(), 1.0, random));
    }
  }

  [[nodiscard]] int count() const { return static_cast<int>(poses_.size()); }
  [[nodiscard]] const CameraModel& camera() const { return camera_; }
  [[nodiscard]] const std::vector<MappedTag>& tags() const { return tags_; }
  [[nodiscard]] const CameraPose& truth(int view) const { return poses_[at(view)]; }
  // Start pose, about one pixel from the truth.
  [[nodiscard]] const CameraPose& start(int view) const { return starts_[at(view)]; }

  [[nodiscard]] GreyImage image(int view, const Tone& tone, double noise_grey,
                                double gain = 1.0) const {
    std::mt19937_64 random(31U + static_cast<std::uint64_t>(view));
    std::normal_distribution<double> noise(0.0, 1.0);
    GreyImage image;
    image.width = camera_.width();
    image.height = camera_.height();
    for (const double light : light_[at(view)]) {
      const double grey = 255.0 * tone(std::min(gain * light, 1.0)) +
                          noise_grey * (noise_grey > 0.0 ? noise(random) : 0.0);
      image.pixels.push_back(static_cast<std::uint8_t>(std::lround(std::clamp(grey, 0.0, 255.0))));
    }
    return image;
  }

  [[nodiscard]] ToneEstimator shown(const Tone& tone, double noise_grey, double gain = 1.0) const {
    ToneEstimator estimator = ToneEstimator::create(camera_, tags_).value();
    for (int k = 0; k < count(); ++k)
      estimator.add(image(k, tone, noise_grey, gain).view(), start(k));
    return estimator;
  }

 private:
  static std::size_t at(int view) { return static_cast<std::size_t>(view); }
  CameraModel camera_ = desk_camera();
  std::vector<MappedTag> tags_;
  std::vector<CameraPose> poses_, starts_;
  std::vector<std::vector<double>> light_;
};

PatternRenderOptions sharp() {
  PatternRenderOptions options;
  options.samples = 256;
  return options;
}

const Views& board_views() {
  static const Views views(sharp(), kImages, board(4, 3, 0.04));
  return views;
}

TEST(ToneEstimator, EstimatesExponentOfImages) {
  int cases = 0;
  for (const double noise : {0.0, 2.0, 8.0}) {
    for (const double exponent : {1.0, 1.2, 1.6, 2.0, 2.4}) {
      // The short form tests every second combination.
      if (!test::nightly() && cases++ % 2 != 0) continue;
      SCOPED_TRACE(fmt::format("exponent {}, noise {}", exponent, noise));
      const auto estimate = board_views().shown(power(exponent), noise).estimate();
      ASSERT_TRUE(estimate) << estimate.error().message;
      EXPECT_EQ(estimate->images, kImages);
      EXPECT_NEAR(estimate->exponent, exponent, std::min(estimate->sigma, 0.03));
      EXPECT_LT(estimate->sigma, 0.15);
      // Lens blur of 0.5 px, combined with the pixel's box.
      EXPECT_NEAR(estimate->blur_px, std::hypot(0.5, std::sqrt(1.0 / 12.0)), 0.02);
    }
  }
}

// A power law scaled by a brightness factor keeps its exponent.
TEST(ToneEstimator, IsIndependentOfExposure) {
  for (const double gain : {0.3, 0.6, 1.15}) {
    const auto estimate = board_views().shown(power(1.6), 2.0, gain).estimate();
    ASSERT_TRUE(estimate) << gain << ": " << estimate.error().message;
    EXPECT_NEAR(estimate->exponent, 1.6, 0.03) << gain;
  }
}

TEST(ToneEstimator, EstimatesBlur) {
  for (const double lens_px : {0.2, 0.8, 1.2}) {
    PatternRenderOptions options = sharp();
    options.lens_blur_px = lens_px;
    if (!test::nightly()) options.samples = 96;
    const Views views(options, kImages, board(3, 2, 0.06));
    for (const double exponent : {1.0, 2.2}) {
      const auto estimate = views.shown(power(exponent), 2.0).estimate();
      ASSERT_TRUE(estimate) << lens_px << ": " << estimate.error().message;
      EXPECT_NEAR(estimate->exponent, exponent, estimate->sigma) << lens_px;
      EXPECT_NEAR(estimate->blur_px, std::hypot(lens_px, std::sqrt(1.0 / 12.0)), 0.05);
    }
  }
}

TEST(ToneEstimator, IgnoresOccludedThirdOfEveryTag) {
  PatternRenderOptions options = sharp();
  options.covered_fraction = 0.3;
  const Views views(options, kImages, board(4, 3, 0.04));
  for (const double exponent : {1.0, 2.2}) {
    const auto estimate = views.shown(power(exponent), 2.0).estimate();
    ASSERT_TRUE(estimate) << estimate.error().message;
    EXPECT_NEAR(estimate->exponent, exponent, 0.04);
  }
}

// sRGB is close to a power law, so the estimated exponent removes the bias of an alignment that
// ignores the response.
TEST(ToneEstimator, RemovesAlignmentBiasByEstimatedExponent) {
  const Views& views = board_views();
  const auto estimate = views.shown(srgb, 0.0).estimate();
  ASSERT_TRUE(estimate) << estimate.error().message;
  EXPECT_GT(estimate->exponent, 1.8);
  EXPECT_LT(estimate->exponent, 2.5);
  AlignmentOptions options;
  options.effort = AlignmentEffort::accurate;
  const auto error2 = [&](double exponent) {
    options.tone_exponent = exponent;
    auto aligner = TagAligner::create(views.camera(), views.tags(), options).value();
    double sum = 0.0;
    for (int k = 0; k < views.count(); ++k) {
      const GreyImage image = views.image(k, srgb, 0.0);
      AlignmentInput input;
      input.luma = image.view();
      input.predicted = as_map_pose(views.start(k));
      input.covariance = test::loose_prior(0.05, 0.1);
      const double error = overlay_difference(views.camera(), aligner.align(input).T_map_camera,
                                              as_map_pose(views.truth(k)))
                               .rms_px();
      sum += error * error / views.count();
    }
    return sum;
  };
  const double without = std::sqrt(error2(1.0));
  const double with = std::sqrt(error2(estimate->exponent));
  EXPECT_LT(with, 0.5 * without) << with << " and " << without << " px";
}

// For a response that is not a power law, the best exponent depends on the exposure. The change
// must stay below the estimate's uncertainty.
TEST(ToneEstimator, BoundsExponentChangeAcrossSrgbExposures) {
  const auto bright = board_views().shown(srgb, 2.0).estimate();
  ASSERT_TRUE(bright) << bright.error().message;
  for (const double gain : {0.4, 0.7, 1.15}) {
    const auto estimate = board_views().shown(srgb, 2.0, gain).estimate();
    ASSERT_TRUE(estimate) << gain << ": " << estimate.error().message;
    EXPECT_NEAR(estimate->exponent, bright->exponent, estimate->sigma) << gain;
  }
}

// One image has another response than the others, for example because of a reflection.
TEST(ToneEstimator, RejectsInconsistentImage) {
  const Views& views = board_views();
  ToneEstimator estimator = ToneEstimator::create(views.camera(), views.tags()).value();
  for (int k = 0; k < views.count(); ++k) {
    const GreyImage image = views.image(k, power(k == 2 ? 3.0 : 1.4), 2.0);
    EXPECT_TRUE(estimator.add(image.view(), views.start(k)));
  }
  const auto estimate = estimator.estimate();
  ASSERT_TRUE(estimate) << estimate.error().message;
  EXPECT_NEAR(estimate->exponent, 1.4, 0.03);
}

TEST(ToneEstimator, FailsForInconsistentImages) {
  const Views& views = board_views();
  ToneEstimator estimator = ToneEstimator::create(views.camera(), views.tags()).value();
  for (int k = 0; k < views.count(); ++k)
    estimator.add(views.image(k, power(1.0 + 0.5 * k), 2.0).view(), views.start(k));
  const auto estimate = estimator.estimate();
  ASSERT_FALSE(estimate);
  EXPECT_NE(estimate.error().message.find("determine the exponent of the camera response only to"),
            std::string::npos)
      << estimate.error().message;
}

TEST(ToneEstimator, FailsForTooFewImages) {
  const Views& views = board_views();
  ToneEstimator estimator = ToneEstimator::create(views.camera(), views.tags()).value();
  for (int k = 0; k < 4; ++k)
    EXPECT_TRUE(estimator.add(views.image(k, power(1.4), 2.0).view(), views.start(k)));
  const auto estimate = estimator.estimate();
  ASSERT_FALSE(estimate);
  EXPECT_NE(estimate.error().message.find("4 images"), std::string::npos);
}

TEST(ToneEstimator, RejectsUninformativeImages) {
  const Views& views = board_views();
  const GreyImage good = views.image(0, power(1.4), 2.0);
  ToneEstimator estimator = ToneEstimator::create(views.camera(), views.tags()).value();
  EXPECT_FALSE(estimator.add({}, views.start(0)));
  EXPECT_FALSE(estimator.add({good.pixels.data(), 320, 240, 640}, views.start(0)));
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(estimator.add(
      good.view(), CameraPose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(nan, 0.0, 0.4))));
  EXPECT_FALSE(estimator.add(good.view(), views.start(1)));  // the board's pose is wrong
  EXPECT_FALSE(estimator.add(views.image(0, power(1.4), 2.0, 1.6).view(), views.start(0)))
      << "the paper is overexposed";
  EXPECT_FALSE(estimator.add(views.image(0, power(1.0), 2.0, 0.1).view(), views.start(0)))
      << "the contrast is too low";
  GreyImage flat = good;
  for (const int grey : {0, 128, 255}) {
    std::fill(flat.pixels.begin(), flat.pixels.end(), static_cast<std::uint8_t>(grey));
    EXPECT_FALSE(estimator.add(flat.view(), views.start(0)));
  }
  std::mt19937_64 random(3);
  for (std::uint8_t& pixel : flat.pixels) pixel = static_cast<std::uint8_t>(random());
  EXPECT_FALSE(estimator.add(flat.view(), views.start(0)));
  EXPECT_TRUE(estimator.add(good.view(), views.start(0)));
}

TEST(ToneEstimator, IsDeterministic) {
  const auto first = board_views().shown(power(1.7), 5.0).estimate();
  const auto second = board_views().shown(power(1.7), 5.0).estimate();
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->exponent, second->exponent);
  EXPECT_EQ(first->sigma, second->sigma);
  EXPECT_EQ(first->blur_px, second->blur_px);
}

}  // namespace
}  // namespace penumbra
