// Refinement of the lens by a survey of tags. Corners have independent errors.
#include "calib/survey/lens_refinement.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "calib/survey/tag_survey.hpp"
#include "core/units.hpp"
#include "support/cameras.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

struct SweepOptions {
  int frames = 24;
  double min_elevation_deg = 35.0;
  double max_elevation_deg = 80.0;
  double noise_px = 0.05;
  double paper_m = 0.0;  // sigma of the corners' heights over their tags' planes
  unsigned seed = 1;
};

// Measured tags of a board of twelve 40 mm tags, all of them completely in the image.
std::vector<SurveyFrame> sweep(const CameraModel& camera, const std::vector<MappedTag>& board,
                               const SweepOptions& options) {
  std::mt19937 random(options.seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> u(0.0, 1.0);
  std::vector<std::array<double, 4>> heights(board.size());
  for (auto& corners : heights) {
    for (double& height : corners) height = options.paper_m * normal(random);
  }
  std::vector<SurveyFrame> frames;
  for (int k = 0; k < options.frames; ++k) {
    const double span = options.max_elevation_deg - options.min_elevation_deg;
    const CameraPose pose = test::looking_at(
        {0.04 * (u(random) - 0.5), 0.04 * (u(random) - 0.5), 0.0}, 0.3 + 0.1 * u(random),
        radians(options.min_elevation_deg + span * u(random)), radians(360.0 * u(random)),
        radians(60.0 * (u(random) - 0.5)));
    const auto T_camera_table = pose.inverse();
    SurveyFrame frame;
    for (std::size_t i = 0; i < board.size(); ++i) {
      const auto corners = board[i].corners();
      MeasuredTag measured;
      measured.covariance = std::max(1e-4, std::pow(options.noise_px, 2)) * Matrix8d::Identity();
      bool visible = true;
      for (std::size_t c = 0; c < 4 && visible; ++c) {
        const Eigen::Vector3d p = corners[c] + heights[i][c] * Eigen::Vector3d::UnitZ();
        const auto pixel = camera.project(T_camera_table * p);
        visible = pixel && pixel->x() > 4.0 && pixel->y() > 4.0 &&
                  pixel->x() < camera.width() - 5.0 && pixel->y() < camera.height() - 5.0;
        if (visible) {
          measured.corners_px[c] =
              *pixel + options.noise_px * Eigen::Vector2d(normal(random), normal(random));
        }
      }
      if (!visible) continue;
      frame.tags.push_back({});
      frame.tags.back().id = board[i].id;
      frame.tags.back().corners_px = measured.corners_px;
      frame.measured.push_back(measured);
    }
    frames.push_back(std::move(frame));
  }
  return frames;
}

// The error of the recording `lens`.
CameraModel with_wrong_lens(const CameraModel& camera, double factor = 1.0) {
  CameraParameters p = camera.parameters();
  p.fx *= 1.0 + 0.006 * factor;
  p.fy *= 1.0 + 0.006 * factor;
  p.cx += 2.4 * factor;
  p.cy -= 1.8 * factor;
  p.distortion[0] += 0.02 * factor;
  return CameraModel::make(p).value();
}

Eigen::VectorXd parameters_of(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const int count = coefficient_count(p.model);
  Eigen::VectorXd lens(4 + count);
  lens << p.fx, p.fy, p.cx, p.cy, Eigen::Map<const Eigen::VectorXd>(p.distortion.data(), count);
  return lens;
}

class LensRefinement : public testing::Test {
 protected:
  CameraModel camera_ = test::desk_camera();
  std::vector<MappedTag> board_ = test::board(4, 3, 0.04);
  SurveyOptions options_ = [] {
    SurveyOptions options;
    options.tag_size_m = 0.04;
    options.refine_camera = true;
    return options;
  }();
};

TEST(LensPrior, IsPositiveDefiniteForAllLensesAndSizes) {
  for (const DistortionModel model : kDistortionModels) {
    for (const double f : {1e-2, 30.0, 500.0, 1e6}) {
      for (const int width : {1, 640, 32768}) {
        SCOPED_TRACE(fmt::format("{} f {} width {}", to_string(model), f, width));
        CameraParameters p;
        p.model = model;
        p.width = width;
        p.height = 480;
        p.fx = p.fy = f;
        p.cx = p.cy = 1.0;
        const CameraModel camera = CameraModel::make(p).value();
        const Eigen::MatrixXd prior = typical_lens_prior(camera);
        ASSERT_EQ(prior.rows(), 4 + coefficient_count(model));
        EXPECT_TRUE(prior.allFinite());
        const Eigen::VectorXd scale = prior.diagonal().cwiseSqrt().cwiseInverse();
        const Eigen::MatrixXd correlation = scale.asDiagonal() * prior * scale.asDiagonal();
        EXPECT_EQ(Eigen::LLT<Eigen::MatrixXd>(correlation).info(), Eigen::Success);
        // k1 displaces the corners of the image by 1 % of half of the diagonal.
        const double corner = 0.5 * std::hypot(width, 480) / f;
        EXPECT_NEAR(std::sqrt(prior(4, 4)) * corner * corner, 0.01, 1e-12);
      }
    }
  }
}

TEST(LensPrior, UsesStandardDeviationsOfMatchingFile) {
  const CameraModel camera = test::desk_camera();
  const std::vector<double> sigmas = {0.3, 0.3, 0.5, 0.6, 0.002, 0.008, 1e-4, 1e-4, 0.0};
  const Eigen::MatrixXd prior = lens_prior_of(camera, sigmas);
  ASSERT_EQ(prior.rows(), 9);
  EXPECT_NEAR(std::sqrt(prior(2, 2)), 0.5, 1e-12);
  EXPECT_GT(prior(8, 8), 0.0) << "a fixed coefficient";
  EXPECT_EQ(prior(0, 1), 0.0);
  for (const double bad : {std::numeric_limits<double>::quiet_NaN(),
                           std::numeric_limits<double>::infinity(), -1.0, 1e300}) {
    auto wrong = sigmas;
    wrong[3] = bad;
    EXPECT_EQ(lens_prior_of(camera, wrong).size(), 0) << bad;
  }
  EXPECT_EQ(lens_prior_of(camera, {}).size(), 0);
  EXPECT_EQ(lens_prior_of(test::lens_of(DistortionModel::fisheye), sigmas).size(), 0);
}

TEST_F(LensRefinement, CorrectsLensWithinPredictedErrors) {
  for (const DistortionModel model : kDistortionModels) {
    SCOPED_TRACE(to_string(model));
    const CameraModel truth = test::lens_of(model);
    const CameraModel given = with_wrong_lens(truth);
    const auto survey = survey_tags(given, sweep(truth, board_, {}), options_);
    ASSERT_TRUE(survey) << survey.error().message;
    ASSERT_TRUE(survey->lens_is_refined());
    EXPECT_GT(survey->lens_gain, 0.5);
    const Eigen::VectorXd error = parameters_of(survey->camera) - parameters_of(truth);
    const Eigen::VectorXd before = parameters_of(given) - parameters_of(truth);
    const Eigen::VectorXd sigma = survey->lens_covariance.diagonal().cwiseSqrt();
    for (Eigen::Index i = 0; i < error.size(); ++i) {
      EXPECT_LT(std::abs(error[i]), 3.5 * sigma[i]) << i;
      EXPECT_LE(sigma[i], 1.05 * std::sqrt(survey->lens_prior(i, i))) << i;
    }
    EXPECT_LT(error.head<4>().norm(), 0.4 * before.head<4>().norm());
  }
}

TEST_F(LensRefinement, KeepsTrueLens) {
  for (const double noise_px : {0.01, 0.05, 0.3}) {
    for (unsigned seed = 1; seed <= 2; ++seed) {
      SweepOptions views;
      views.noise_px = noise_px;
      views.seed = seed;
      const auto survey = survey_tags(camera_, sweep(camera_, board_, views), options_);
      ASSERT_TRUE(survey) << survey.error().message;
      EXPECT_EQ(parameters_of(survey->camera), parameters_of(camera_)) << noise_px << ' ' << seed;
      EXPECT_EQ(survey->lens_covariance.size(), 0);
    }
  }
}

// Corners that are 0.1 mm off their tags' planes are errors that the lens could partly compensate.
TEST_F(LensRefinement, KeepsTrueLensOverUnevenPaper) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    SweepOptions views;
    views.paper_m = 1e-4;
    views.seed = seed;
    const auto survey = survey_tags(camera_, sweep(camera_, board_, views), options_);
    ASSERT_TRUE(survey) << survey.error().message;
    EXPECT_EQ(parameters_of(survey->camera), parameters_of(camera_)) << seed;
  }
}

TEST_F(LensRefinement, UsesPriorOfFileUnlessInconsistentWithSweep) {
  const auto frames = sweep(camera_, board_, {});
  const CameraModel given = with_wrong_lens(camera_);
  options_.lens_sigmas = {3.0, 3.0, 3.0, 3.0, 0.02, 0.01, 0.001, 0.001, 0.01};
  const auto fits = survey_tags(given, frames, options_);
  ASSERT_TRUE(fits) << fits.error().message;
  ASSERT_TRUE(fits->lens_is_refined());
  EXPECT_NEAR(std::sqrt(fits->lens_prior(0, 0)), 3.0, 1e-9);
  for (double& sigma : options_.lens_sigmas) sigma *= 0.003;
  const auto contradicts = survey_tags(given, frames, options_);
  ASSERT_TRUE(contradicts) << contradicts.error().message;
  ASSERT_TRUE(contradicts->lens_is_refined());
  EXPECT_EQ(contradicts->lens_prior, typical_lens_prior(given));
  EXPECT_NEAR(contradicts->camera.parameters().fx, camera_.parameters().fx, 1.0);
}

// Few or similar views leave directions of the lens open, which only the prior bounds.
TEST_F(LensRefinement, StaysWithinPriorForPoorSweeps) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  int refined = 0;
  for (unsigned k = 0; k < 24; ++k) {
    SweepOptions views;
    views.frames = 2 + static_cast<int>(10.0 * u(random));
    views.min_elevation_deg = 30.0 + 58.0 * u(random);
    views.max_elevation_deg = views.min_elevation_deg + 2.0;
    views.noise_px = 0.6 * u(random);
    views.seed = k;
    SCOPED_TRACE(fmt::format("{}: {} frames, noise {:.2f}", k, views.frames, views.noise_px));
    const CameraModel given = with_wrong_lens(camera_, 3.0 * (u(random) - 0.5));
    const auto survey = survey_tags(given, sweep(camera_, board_, views), options_);
    if (!survey) continue;  // too few views of some tag
    const Eigen::VectorXd change = parameters_of(survey->camera) - parameters_of(given);
    ASSERT_TRUE(change.allFinite());
    if (!survey->lens_is_refined()) {
      EXPECT_TRUE(change.isZero());
      continue;
    }
    ++refined;
    EXPECT_GT(survey->lens_gain, 0.0);
    EXPECT_TRUE(survey->lens_covariance.allFinite());
    EXPECT_LT(change.dot(typical_lens_prior(given).ldlt().solve(change)), 9.0 * 9.0);
  }
  EXPECT_GE(refined, 2);
}

}  // namespace
}  // namespace penumbra
