// The solver on simulated views through a known lens.
#include "calib/solver/intrinsics_solver.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

#include "calib/camera_calibration.hpp"
#include "support/calibration_views.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

TEST(IntrinsicsSolver, CalibratesWebcamWithoutInitialGuess) {
  std::mt19937 rng(1);
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  const auto views = test::simulate_views(truth, board, {.noise_px = 0.0}, rng);
  const auto solved = solve_intrinsics(640, 480, board, views);
  ASSERT_TRUE(solved) << solved.error().message;
  EXPECT_LT(projection_difference(truth, solved->camera).mean_px, 1e-4);
  EXPECT_LT(solved->rms_px, 1e-5);
  EXPECT_NEAR(solved->camera.parameters().fx, 531.7, 1e-3);
}

TEST(IntrinsicsSolver, CalibratesFisheyeWithoutInitialGuess) {
  std::mt19937 rng(2);
  const CameraModel truth = test::wide_lens();
  const auto board = test::flat_board();
  const auto views = test::simulate_views(truth, board, {.noise_px = 0.0, .distance_m = 0.15}, rng);
  SolverOptions options;
  options.model = DistortionModel::fisheye;
  const auto solved = solve_intrinsics(640, 480, board, views, options);
  ASSERT_TRUE(solved) << solved.error().message;
  EXPECT_LT(projection_difference(truth, solved->camera).mean_px, 1e-3);
}

TEST(IntrinsicsSolver, CalibratesEveryModelWithoutInitialGuess) {
  const auto board = test::flat_board();
  for (const DistortionModel model : kDistortionModels) {
    SCOPED_TRACE(to_string(model));
    std::mt19937 rng(12);
    const CameraModel truth = test::lens_of(model);
    const auto views = test::simulate_views(truth, board, {.noise_px = 0.0}, rng);
    SolverOptions options;
    options.model = model;
    const auto solved = solve_intrinsics(640, 480, board, views, options);
    ASSERT_TRUE(solved) << solved.error().message;
    EXPECT_EQ(solved->camera.parameters().model, model);
    EXPECT_LT(projection_difference(truth, solved->camera).mean_px, 1e-3);
  }
}

TEST(IntrinsicsSolver, RejectsOutlierCorners) {
  std::mt19937 rng(3);
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  auto views = test::simulate_views(truth, board, {.noise_px = 0.05}, rng);
  int wrong = 0;
  for (CalibrationView& view : views) {
    for (std::size_t i = 5; i < view.corners.size(); i += 17, ++wrong)
      view.corners[i].pixel += Eigen::Vector2d(6.0, -4.0);
  }
  const auto solved = solve_intrinsics(640, 480, board, views);
  ASSERT_TRUE(solved) << solved.error().message;
  EXPECT_GE(solved->outliers, wrong);
  EXPECT_LT(solved->outliers, wrong + solved->corners / 100);
  EXPECT_LT(projection_difference(truth, solved->camera).mean_px, 0.1);
  for (CalibrationView& view : views) view.outlier.assign(view.corners.size(), false);
  const auto spoilt = solve_intrinsics(*solved, board, views);
  ASSERT_TRUE(spoilt);
  EXPECT_GT(projection_difference(truth, spoilt->camera).mean_px, 0.2)
      << "without rejection the outliers must spoil the result";
}

TEST(IntrinsicsSolver, EstimatesBoardWarp) {
  std::mt19937 rng(4);
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  auto bowed = board;
  for (Eigen::Vector3d& p : bowed) p.z() += 0.15 * p.x() * p.x();
  const auto views = test::simulate_views(truth, bowed, {.views = 20, .noise_px = 0.05}, rng);
  const auto rigid = solve_intrinsics(640, 480, board, views);
  ASSERT_TRUE(rigid);
  for (const BoardShape shape : {BoardShape::bowed, BoardShape::free}) {
    SolverOptions options;
    options.shape = shape;
    const auto solved = solve_intrinsics(*rigid, board, views, options);
    ASSERT_TRUE(solved) << solved.error().message;
    EXPECT_LT(solved->rms_px, 0.5 * rigid->rms_px) << to_string(shape);
    EXPECT_LT(projection_difference(truth, solved->camera).mean_px,
              projection_difference(truth, rigid->camera).mean_px)
        << to_string(shape);
    const auto held_out = held_out_errors(*solved, board, views, options);
    const auto held_out_rigid = held_out_errors(*rigid, board, views, SolverOptions{});
    ASSERT_TRUE(held_out && held_out_rigid);
    EXPECT_LT(rms_of(*held_out), rms_of(*held_out_rigid)) << to_string(shape);
  }
}

// Mean projection errors of several calibrations whose board is deformed by `bend`.
struct ShapeErrors {
  double rigid_px = 0.0;
  double free_px = 0.0;
};
ShapeErrors errors_with(const std::function<void(Eigen::Vector3d&, std::mt19937&)>& bend) {
  // The bounds are ratios of errors with the same views and noise, so one run suffices.
  const unsigned runs = test::nightly() ? 5 : 1;
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  ShapeErrors sum;
  for (unsigned run = 0; run < runs; ++run) {
    std::mt19937 rng(40 + run);
    auto real = board;
    for (Eigen::Vector3d& p : real) bend(p, rng);
    const auto views = test::simulate_views(truth, real, {.views = 15, .noise_px = 0.06}, rng);
    const auto rigid = solve_intrinsics(640, 480, board, views);
    EXPECT_TRUE(rigid);
    if (!rigid) return {0.0, 1e9};
    SolverOptions options;
    options.shape = BoardShape::free;
    const auto free = solve_intrinsics(*rigid, board, views, options);
    EXPECT_TRUE(free) << free.error().message;
    if (!free) return {0.0, 1e9};
    sum.rigid_px += projection_difference(truth, rigid->camera).mean_px / runs;
    sum.free_px += projection_difference(truth, free->camera).mean_px / runs;
  }
  return sum;
}

TEST(IntrinsicsSolver, CorrectsWavyBoardWithoutHarmingFlatBoard) {
  const auto waves = [](Eigen::Vector3d& p, std::mt19937& rng) {
    std::normal_distribution<double> print(0.0, 2e-5);
    p += Eigen::Vector3d(print(rng), print(rng),
                         3e-4 * (std::sin(27.0 * p.x() + 1.0) + std::cos(20.0 * p.y())));
  };
  const ShapeErrors wavy = errors_with(waves);
  EXPECT_LT(wavy.free_px, 0.5 * wavy.rigid_px);
  // On a flat board, the additional warp parameters must not degrade the principal point.
  const auto none = [](Eigen::Vector3d&, std::mt19937&) {};
  const ShapeErrors flat = errors_with(none);
  EXPECT_LT(flat.free_px, 1.5 * flat.rigid_px);
  // The printer stretched the sheet by 0.1 %.
  const auto stretched = [](Eigen::Vector3d& p, std::mt19937&) { p.y() *= 1.001; };
  const ShapeErrors longer = errors_with(stretched);
  EXPECT_LT(longer.free_px, 2.0 * longer.rigid_px);
}

// The square size must not affect the lens: a wrong size scales all distances and can't be observed
// in the views.
TEST(IntrinsicsSolver, KeepsLensIndependentOfSquareSize) {
  std::mt19937 rng(7);
  const auto board = test::flat_board();
  auto twice = board;
  for (Eigen::Vector3d& p : twice) p *= 2.0;
  const auto views = test::simulate_views(test::desk_camera(), board, {}, rng);
  const auto solved = solve_intrinsics(640, 480, board, views);
  const auto doubled = solve_intrinsics(640, 480, twice, views);
  ASSERT_TRUE(solved && doubled);
  EXPECT_LT(projection_difference(solved->camera, doubled->camera).largest_px, 1e-3);
  EXPECT_NEAR(doubled->views[0].T_board_camera.translation().norm() /
                  solved->views[0].T_board_camera.translation().norm(),
              2.0, 1e-4);
}

TEST(IntrinsicsSolver, MatchesLensJacobianToCentralDifferences) {
  for (const CameraModel& camera : {test::desk_camera(), test::wide_lens()}) {
    const CameraParameters& p = camera.parameters();
    const int count = 4 + coefficient_count(p.model);
    for (const Eigen::Vector2d& xy : {Eigen::Vector2d(0.3, -0.2), Eigen::Vector2d(-0.5, 0.4)}) {
      const Eigen::MatrixXd J = lens_jacobian(camera, xy);
      ASSERT_EQ(J.cols(), count);
      for (int i = 0; i < count; ++i) {
        const auto moved = [&](double by) {
          CameraParameters q = p;
          double* const at[] = {&q.fx, &q.fy, &q.cx, &q.cy};
          (i < 4 ? *at[i] : q.distortion[static_cast<std::size_t>(i - 4)]) += by;
          return CameraModel::make(q).value().project_unchecked({xy.x(), xy.y(), 1.0});
        };
        const double step = 1e-6;
        const Eigen::Vector2d numeric = (moved(step) - moved(-step)) / (2.0 * step);
        EXPECT_LT((numeric - J.col(i)).norm(), 1e-4 * (1.0 + J.col(i).norm())) << i;
      }
    }
  }
}

TEST(IntrinsicsSolver, RejectsTwoViewsWithReason) {
  std::mt19937 rng(5);
  const auto board = test::flat_board();
  const auto views = test::simulate_views(test::desk_camera(), board, {.views = 2}, rng);
  const auto solved = solve_intrinsics(640, 480, board, views);
  ASSERT_FALSE(solved);
  EXPECT_THAT(solved.error().message, HasSubstr("at least 3"));
}

// Short form of the stress test: the true projection lies within the predicted uncertainty, except
// at 5 % of the points. If one of the 4 calibrations were wrong everywhere, more points would lie
// outside.
TEST(IntrinsicsSolver, PredictsUncertaintyConsistentWithErrors) {
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  int inside = 0;
  int all = 0;
  double ratio = 0.0;
  for (unsigned run = 0; run < (test::nightly() ? 20 : 4); ++run) {
    std::mt19937 rng(100 + run);
    const auto views = test::simulate_views(truth, board, {.views = 12, .noise_px = 0.2}, rng);
    const auto solved = solve_intrinsics(640, 480, board, views);
    ASSERT_TRUE(solved) << solved.error().message;
    for (int j = 0; j < 6; ++j) {
      for (int i = 0; i < 8; ++i) {
        const Eigen::Vector2d pixel((i + 0.5) * 80.0, (j + 0.5) * 80.0);
        const auto direction = solved->camera.unproject(pixel);
        const auto covariance = projection_covariance(solved->camera, solved->covariance, pixel);
        ASSERT_TRUE(direction && covariance);
        const Eigen::Vector2d error = truth.project_unchecked(*direction) - pixel;
        const double sigmas = std::sqrt(error.dot(covariance->inverse() * error));
        ++all;
        if (sigmas <= 3.0) ++inside;
        ratio += sigmas * sigmas / 2.0;
      }
    }
  }
  EXPECT_GE(inside, 0.95 * all);
  // The uncertainty must not be too large either.
  EXPECT_GT(ratio / all, 0.3);
}

}  // namespace
}  // namespace penumbra
