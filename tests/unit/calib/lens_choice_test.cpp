// Choice of the lens model in a calibration, and rejected models.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "calib/camera_calibration.hpp"
#include "calib/target/image_cells.hpp"
#include "core/units.hpp"
#include "support/calibration_views.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

CameraModel lens(DistortionModel model, double f, std::array<double, 8> distortion) {
  CameraParameters p = test::desk_camera().parameters();
  p.fx = p.fy = f;
  p.model = model;
  p.distortion = distortion;
  return CameraModel::make(p).value();
}

TEST(NonMonotonicDistortion, IsLocatedWhereRadiusStopsGrowing) {
  EXPECT_FALSE(non_monotonic_place_in_image(test::desk_camera()));
  EXPECT_FALSE(non_monotonic_place_in_image(test::wide_lens()));
  // r (1 - r^2 / 3) increases up to r = 1, where its value is 2/3. At f = 200 that is 133 px, which
  // is inside the upper and lower image borders.
  const CameraModel non_monotonic = lens(DistortionModel::plumb_bob, 200.0, {-1.0 / 3.0});
  const auto at = non_monotonic_place_in_image(non_monotonic);
  ASSERT_TRUE(at);
  EXPECT_NEAR(at->x(), non_monotonic.parameters().cx, 10.0);
  // Non-monotonic in the corners only, from 0.75 of the half diagonal.
  const auto corner =
      non_monotonic_place_in_image(lens(DistortionModel::plumb_bob, 450.0, {-1.0 / 3.0}));
  ASSERT_TRUE(corner);
  EXPECT_GT(std::abs(corner->x() - 320.0), 180.0);
  EXPECT_GT(std::abs(corner->y() - 240.0), 130.0);
  // The radius levels off without decreasing: a rational approximation of r / (1 + r^2)^0.5.
  EXPECT_TRUE(non_monotonic_place_in_image(
      lens(DistortionModel::rational, 150.0, {0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.02, 0.0})));
  // A fisheye lens may be monotonic beyond 90 degrees.
  EXPECT_FALSE(non_monotonic_place_in_image(lens(DistortionModel::fisheye, 150.0, {})));
}

TEST(UncertaintyMap, IsUnboundedForNonMonotonicLens) {
  const CameraModel non_monotonic = lens(DistortionModel::plumb_bob, 450.0, {-1.0 / 3.0});
  const Eigen::MatrixXd tiny = 1e-12 * Eigen::MatrixXd::Identity(9, 9);
  EXPECT_LT(uncertainty_map(test::desk_camera(), tiny).largest_px, 0.1);
  EXPECT_TRUE(std::isinf(uncertainty_map(non_monotonic, tiny).largest_px));
  EXPECT_TRUE(std::isinf(uncertainty_map(non_monotonic, tiny).mean_px));
}

struct Chosen {
  Result<ChosenLens> lens;
  std::vector<ModelTrial> trials;
};
Chosen choose(const CameraModel& truth, const test::ViewOptions& options, unsigned seed,
              const LensChoice& choice = {}) {
  std::mt19937 rng(seed);
  const auto board = test::flat_board();
  const auto views = test::simulate_views(truth, board, options, rng);
  SolverOptions solver;
  solver.model = choice.model.value_or(DistortionModel::plumb_bob);
  auto start = solve_intrinsics(truth.width(), truth.height(), board, views, solver);
  if (!choice.model && (!start || start->noise_px > 0.5)) {
    solver.model = DistortionModel::fisheye;
    start = solve_intrinsics(truth.width(), truth.height(), board, views, solver);
  }
  std::vector<ModelTrial> trials;
  if (!start) return {tl::unexpected(start.error()), {}};
  auto chosen = choose_lens(*start, board, views, choice, BoardShape::rigid, trials);
  return {std::move(chosen), std::move(trials)};
}

TEST(LensChoice, ChoosesSimplestLensThatExplainsViews) {
  const test::ViewOptions few = {.views = 8, .noise_px = 0.15};
  const Chosen plain =
      choose(lens(DistortionModel::plumb_bob, 531.7, {-0.215, 0.062, 0.0008, -0.0006}), few, 21);
  ASSERT_TRUE(plain.lens) << plain.lens.error().message;
  EXPECT_TRUE(plain.lens->without_k3);
  EXPECT_EQ(plain.lens->solution.camera.parameters().distortion[4], 0.0);
  const test::ViewOptions many = {.views = 20, .noise_px = 0.05};
  const Chosen strong =
      choose(lens(DistortionModel::plumb_bob, 531.7, {-0.3, 0.15, 0.0, 0.0, -0.06}), many, 22);
  ASSERT_TRUE(strong.lens) << strong.lens.error().message;
  EXPECT_EQ(strong.lens->solution.camera.parameters().model, DistortionModel::plumb_bob);
  EXPECT_FALSE(strong.lens->without_k3);
}

TEST(LensChoice, ChoosesFisheyeWhenViewsNeedIt) {
  const Chosen wide =
      choose(test::wide_lens(),
             {.views = test::nightly() ? 20 : 12, .noise_px = 0.1, .distance_m = 0.15}, 23);
  ASSERT_TRUE(wide.lens) << wide.lens.error().message;
  EXPECT_EQ(wide.lens->solution.camera.parameters().model, DistortionModel::fisheye);
}

// A few noisy views in the middle of the image do not determine the outer distortion.
TEST(LensChoice, NeverChoosesNonMonotonicLens) {
  int refused = 0;
  for (unsigned seed = 0; seed < (test::nightly() ? 12 : 3); ++seed) {
    std::mt19937 rng(300 + seed);
    const CameraModel truth = test::desk_camera();
    const auto small = test::flat_board(6, 5, 0.012);
    auto views = test::simulate_views(truth, small, {.views = 40, .noise_px = 0.4}, rng);
    std::erase_if(views, [](const CalibrationView& view) {
      return std::any_of(view.corners.begin(), view.corners.end(), [](const TargetCorner& c) {
        return (c.pixel - Eigen::Vector2d(320.0, 240.0)).norm() > 150.0;
      });
    });
    if (views.size() < 4) continue;
    views.resize(std::min<std::size_t>(views.size(), 5));
    const auto start = solve_intrinsics(640, 480, small, views);
    if (!start) continue;
    for (const auto& model :
         {std::optional<DistortionModel>(), std::optional(DistortionModel::plumb_bob),
          std::optional(DistortionModel::rational)}) {
      std::vector<ModelTrial> trials;
      const auto chosen =
          choose_lens(*start, small, views, {.model = model}, BoardShape::rigid, trials);
      for (const ModelTrial& trial : trials) {
        refused += trial.non_monotonic_px ? 1 : 0;
        EXPECT_FALSE(trial.chosen && trial.non_monotonic_px);
      }
      if (!chosen) {
        EXPECT_THAT(chosen.error().message, HasSubstr("take views with the target near"));
        continue;
      }
      EXPECT_FALSE(non_monotonic_place_in_image(chosen->solution.camera));
      EXPECT_TRUE(std::isfinite(
          uncertainty_map(chosen->solution.camera, chosen->solution.covariance).largest_px));
    }
  }
  EXPECT_GT(refused, test::nightly() ? 5 : 1)
      << "with these poor views, some lenses must be non-monotonic";
}

// Views with corners near the image's borders. Corners that a lens with too few parameters rejects
// as outliers must be kept; a rational lens fits them and is seldom non-monotonic there.
TEST(LensChoice, KeepsFarCornersThatRicherLensExplains) {
  const CameraModel truth = test::rational_lens();
  int found = 0;
  const unsigned sessions = test::nightly() ? 5 : 1;
  for (unsigned seed = 28; seed > 28 - sessions; --seed) {
    const Chosen wide =
        choose(truth, {.views = 20, .noise_px = 0.05, .distance_m = 0.25, .coverage = 0.95}, seed);
    ASSERT_TRUE(wide.lens) << wide.lens.error().message;
    // On the same corners, the lens with too few parameters has a much larger error.
    ASSERT_TRUE(wide.trials.front().held_out_px);
    EXPECT_GT(*wide.trials.front().held_out_px, 3.0 * *wide.lens->held_out_px);
    if (wide.lens->solution.camera.parameters().model != DistortionModel::rational) continue;
    ++found;
    EXPECT_EQ(wide.lens->solution.outliers, 0);
    EXPECT_LT(projection_difference(truth, wide.lens->solution.camera).mean_px, 0.2);
  }
  EXPECT_GE(found, 0.8 * sessions);
}

TEST(LensChoice, RejectsOutlierCornersForEveryLens) {
  std::mt19937 rng(25);
  const auto board = test::flat_board();
  auto views = test::simulate_views(test::desk_camera(), board, {.noise_px = 0.05}, rng);
  int wrong = 0;
  for (CalibrationView& view : views) {
    for (std::size_t i = 3; i < view.corners.size(); i += 23, ++wrong)
      view.corners[i].pixel += Eigen::Vector2d(7.0, -5.0);
  }
  const auto start = solve_intrinsics(640, 480, board, views);
  ASSERT_TRUE(start) << start.error().message;
  std::vector<ModelTrial> trials;
  const auto chosen = choose_lens(*start, board, views, {}, BoardShape::rigid, trials);
  ASSERT_TRUE(chosen) << chosen.error().message;
  EXPECT_GE(chosen->solution.outliers, wrong);
  for (const ModelTrial& trial : trials) {
    ASSERT_TRUE(trial.held_out_px) << lens_name(trial);
    EXPECT_LT(*trial.held_out_px, 0.3) << lens_name(trial);
  }
}

CameraPose tilted(double degrees) {
  return {Eigen::Quaterniond(Eigen::AngleAxisd(radians(degrees), Eigen::Vector3d::UnitX())),
          Eigen::Vector3d(0.0, 0.0, 0.4)};
}

// A calibration with a small covariance everywhere in the image.
CameraCalibration confident_calibration() {
  CameraCalibration c;
  c.solution.camera = test::desk_camera();
  c.solution.covariance = 1e-12 * Eigen::MatrixXd::Identity(9, 9);
  c.solution.corners = 1000;
  c.solution.views.resize(12);
  c.solution.views[0].T_board_camera = tilted(60.0);
  c.held_out_px = 0.5;
  for (int k = 0; k < 12; ++k) {
    CalibrationImage image;
    image.solved = k;
    for (int i = 0; i < 108; ++i) {
      TargetCorner corner;
      corner.pixel = {20.0 + 600.0 * (i % 12) / 11.0, 20.0 + 440.0 * (i / 12) / 8.0};
      image.view.corners.push_back(corner);
    }
    c.images.push_back(image);
  }
  ModelTrial trial;
  trial.held_out_px = c.held_out_px;
  trial.chosen = true;
  trial.camera = c.solution.camera;
  c.trials.push_back(trial);
  return c;
}

TEST(CalibrationVerdict, IsPoorWhenNonMonotonicLensFitsBetter) {
  CameraCalibration c = confident_calibration();
  judge(c);
  ASSERT_EQ(c.grade, CalibrationGrade::good) << c.verdict;
  ModelTrial non_monotonic;
  non_monotonic.model = DistortionModel::rational;
  non_monotonic.held_out_px = 0.2;
  non_monotonic.non_monotonic_px = Eigen::Vector2d(5.0, 5.0);
  c.trials.push_back(non_monotonic);
  judge(c);
  EXPECT_EQ(c.grade, CalibrationGrade::poor);
  EXPECT_THAT(c.verdict, HasSubstr("rational explains the views better (0.200 px)"));
  EXPECT_THAT(c.verdict, HasSubstr("non-monotonic near the top left"));
  // The rejected lens does not fit better, so the chosen lens is rated good.
  c = confident_calibration();
  non_monotonic.held_out_px = 0.5;
  c.trials.push_back(non_monotonic);
  judge(c);
  EXPECT_EQ(c.grade, CalibrationGrade::good) << c.verdict;
}

TEST(CalibrationVerdict, IncludesSpreadOfEquivalentLensModels) {
  CameraCalibration c = confident_calibration();
  ModelTrial other = c.trials.front();
  other.chosen = false;
  CameraParameters p = other.camera.parameters();
  p.cx += 3.0;
  other.camera = CameraModel::make(p).value();
  c.trials.push_back(other);
  judge(c);
  EXPECT_LT(c.uncertainty.largest_px, 0.1) << "the other lens is not marked as a rival";
  c.trials.back().rival = true;
  judge(c);
  EXPECT_NEAR(c.uncertainty.mean_px, 3.0, 1e-6);
  EXPECT_NEAR(c.uncertainty.largest_px, 3.0, 1e-6);
  EXPECT_EQ(c.grade, CalibrationGrade::poor);
}

// The verdict must contain advice even if the projection is uncertain everywhere.
TEST(CalibrationVerdict, GivesAdviceWhenProjectionIsUnknown) {
  CameraCalibration c = confident_calibration();
  c.solution.covariance = std::numeric_limits<double>::infinity() * Eigen::MatrixXd::Ones(9, 9);
  judge(c);
  EXPECT_EQ(c.grade, CalibrationGrade::poor);
  EXPECT_FALSE(c.advice.empty());
  EXPECT_THAT(c.verdict, HasSubstr("take more views"));
}

TEST(CalibrationVerdict, LimitsRivalDifferencesOutsideObservedArea) {
  CameraCalibration c = confident_calibration();
  ModelTrial other = c.trials.front();
  other.chosen = false;
  other.rival = true;
  CameraParameters p = other.camera.parameters();
  p.distortion[4] += 0.4;  // k3: the difference increases with the radius
  other.camera = CameraModel::make(p).value();
  c.trials.push_back(other);
  judge(c);
  const double everywhere = c.uncertainty.largest_px;
  for (CalibrationImage& image : c.images) {
    std::erase_if(image.view.corners, [](const TargetCorner& corner) {
      return (corner.pixel - Eigen::Vector2d(320.0, 240.0)).norm() > 200.0;
    });
  }
  judge(c);
  EXPECT_LT(c.uncertainty.largest_px, 0.5 * everywhere);
  EXPECT_GT(c.uncertainty.largest_px, 0.0);
  // The uncertainty outside the observed area is at least as large as inside.
  EXPECT_NEAR(c.uncertainty.sigma_px.front(), c.uncertainty.largest_px, 1e-9);
}

// Two lens models may agree by chance on a curve outside the observed area; that agreement is no
// evidence.
TEST(CalibrationVerdict, KeepsUncertaintyWhereRivalLensesAgreeByChance) {
  CameraCalibration c = confident_calibration();
  ModelTrial other = c.trials.front();
  other.chosen = false;
  other.rival = true;
  CameraParameters p = other.camera.parameters();
  // The difference is 3 px to the right in the middle and decreases towards the right.
  p.cx += 3.0;
  p.distortion[0] -= 0.1;
  other.camera = CameraModel::make(p).value();
  c.trials.push_back(other);
  for (CalibrationImage& image : c.images) {
    std::erase_if(image.view.corners, [](const TargetCorner& corner) {
      return (corner.pixel - Eigen::Vector2d(320.0, 240.0)).norm() > 120.0;
    });
  }
  judge(c);
  const UncertaintyMap& map = c.uncertainty;
  const ImageCells cells{map.columns, map.rows, 640, 480};
  for (std::size_t cell = 0; cell < cells.count(); ++cell) {
    if ((cells.middle(cell) - Eigen::Vector2d(320.0, 240.0)).norm() > 200.0) {
      EXPECT_GE(map.sigma_px[cell], 2.5) << cell;
    }
  }
}

TEST(CalibrationVerdict, AdvisesNextViews) {
  // The views have slightly too little tilt.
  CameraCalibration c = confident_calibration();
  c.solution.views[0].T_board_camera = tilted(39.9);
  c.solution.covariance *= 1e8;
  judge(c);
  EXPECT_NE(c.grade, CalibrationGrade::good) << c.verdict;
  EXPECT_THAT(c.verdict, HasSubstr("differ by more than 39 degrees, 40 are good"));
  EXPECT_THAT(c.verdict, testing::Not(HasSubstr("take more views")));
  // The views have no single fault, so the advice is the most informative view.
  c = confident_calibration();
  c.solution.covariance *= 1e8;
  judge(c);
  EXPECT_NE(c.grade, CalibrationGrade::good) << c.verdict;
  EXPECT_THAT(c.verdict, HasSubstr("at the worst place in the image (the "));
  EXPECT_THAT(c.verdict, HasSubstr("; take more views: from near"));
  EXPECT_EQ(c.advice.size(), 1U);
  // One part of the image has no corner, another part has a single corner.
  c = confident_calibration();
  for (CalibrationImage& image : c.images) {
    std::erase_if(image.view.corners, [&](const TargetCorner& corner) {
      const bool top = corner.pixel.y() < 160.0;
      return (top && corner.pixel.x() < 214.0) ||
             (top && corner.pixel.x() > 426.0 &&
              (&image != &c.images.front() || corner.pixel.y() > 60.0));
    });
  }
  judge(c);
  EXPECT_EQ(c.advice, (std::vector<std::string>{"no views near the top left",
                                                "few views near the top right"}));
}

}  // namespace
}  // namespace penumbra
