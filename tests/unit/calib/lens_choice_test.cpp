// Which lens a calibration takes, and which it never takes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <random>

#include "calib/camera_calibration.hpp"
#include "support/calibration_views.hpp"

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

TEST(FoldInImage, IsWhereTheLensStopsGrowing) {
  EXPECT_FALSE(fold_in_image(test::desk_camera()));
  EXPECT_FALSE(fold_in_image(test::wide_lens()));
  // r (1 - r^2 / 3) grows up to r = 1, which is 2/3: 133 px at f = 200. The picture's upper and
  // lower borders are further.
  const CameraModel folds = lens(DistortionModel::plumb_bob, 200.0, {-1.0 / 3.0});
  const auto at = fold_in_image(folds);
  ASSERT_TRUE(at);
  EXPECT_NEAR(at->x(), folds.parameters().cx, 10.0);
  // Only in the corners: 0.75 of the half diagonal.
  const auto corner = fold_in_image(lens(DistortionModel::plumb_bob, 450.0, {-1.0 / 3.0}));
  ASSERT_TRUE(corner);
  EXPECT_GT(std::abs(corner->x() - 320.0), 180.0);
  EXPECT_GT(std::abs(corner->y() - 240.0), 130.0);
  // Levels off and never falls: r / (1 + r^2)^0.5 as a rational would have it near by.
  EXPECT_TRUE(fold_in_image(
      lens(DistortionModel::rational, 150.0, {0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.02, 0.0})));
  // Beyond 90 degrees a fisheye lens may still grow: that is no fold.
  EXPECT_FALSE(fold_in_image(lens(DistortionModel::fisheye, 150.0, {})));
}

TEST(UncertaintyMap, IsNotBoundedForALensThatFolds) {
  const CameraModel folds = lens(DistortionModel::plumb_bob, 450.0, {-1.0 / 3.0});
  const Eigen::MatrixXd tiny = 1e-12 * Eigen::MatrixXd::Identity(9, 9);
  EXPECT_LT(uncertainty_map(test::desk_camera(), tiny).largest_px, 0.1);
  EXPECT_TRUE(std::isinf(uncertainty_map(folds, tiny).largest_px));
  EXPECT_TRUE(std::isinf(uncertainty_map(folds, tiny).mean_px));
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

TEST(LensChoice, TakesTheSimplestLensThatExplainsTheViews) {
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

TEST(LensChoice, TakesAFisheyeLensWhereTheViewsNeedIt) {
  const Chosen wide =
      choose(test::wide_lens(), {.views = 20, .noise_px = 0.1, .distance_m = 0.15}, 23);
  ASSERT_TRUE(wide.lens) << wide.lens.error().message;
  EXPECT_EQ(wide.lens->solution.camera.parameters().model, DistortionModel::fisheye);
}

// Few, noisy views in the middle of the image: far out the coefficients may say anything.
TEST(LensChoice, NeverTakesALensThatFoldsInTheImage) {
  int refused = 0;
  for (unsigned seed = 0; seed < 12; ++seed) {
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
        refused += trial.fold_px ? 1 : 0;
        EXPECT_FALSE(trial.chosen && trial.fold_px);
      }
      if (!chosen) {
        EXPECT_THAT(chosen.error().message, HasSubstr("take views with the target near"));
        continue;
      }
      EXPECT_FALSE(fold_in_image(chosen->solution.camera));
      EXPECT_TRUE(std::isfinite(
          uncertainty_map(chosen->solution.camera, chosen->solution.covariance).largest_px));
    }
  }
  EXPECT_GT(refused, 5) << "the views are meant to be so poor that some lenses fold";
}

}  // namespace
}  // namespace penumbra
