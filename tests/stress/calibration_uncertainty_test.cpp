// 200 simulated calibrations: the true projection lies inside the predicted 3 sigma.
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <random>

#include "calib/camera_calibration.hpp"
#include "support/calibration_views.hpp"
#include "support/stress_form.hpp"

namespace penumbra {
namespace {

// How many image points lie where a calibration says they may.
struct Hits {
  int inside = 0;  // 3 sigma
  int all = 0;
  double chi2 = 0.0;

  void add(const CalibrationSolution& solution, const CameraModel& truth) {
    for (int j = 0; j < 12; ++j) {
      for (int i = 0; i < 16; ++i) {
        const Eigen::Vector2d pixel((i + 0.5) * 40.0, (j + 0.5) * 40.0);
        const auto direction = solution.camera.unproject(pixel);
        const auto covariance = projection_covariance(solution.camera, solution.covariance, pixel);
        ++all;
        if (!direction || !covariance) continue;
        const Eigen::Vector2d error = truth.project_unchecked(*direction) - pixel;
        const double squared = error.dot(covariance->inverse() * error);
        chi2 += squared;
        if (squared <= 9.0) ++inside;
      }
    }
  }
  void expect_honest() const {
    std::printf(
        "inside 3 sigma: %.2f %% of %d image points; mean squared error over predicted: %.2f\n",
        100.0 * inside / all, all, chi2 / (2.0 * all));
    EXPECT_GE(inside, 0.95 * all);
    EXPECT_GT(chi2 / (2.0 * all), 0.3) << "the prediction is too wide to say anything";
  }
};

std::vector<CalibrationView> views_of_run(unsigned run, const CameraModel& truth,
                                          const std::vector<Eigen::Vector3d>& board) {
  std::mt19937 rng(1000 + run);
  std::uniform_real_distribution<double> noise(0.03, 0.4);
  test::ViewOptions options;
  options.views = 8 + static_cast<int>(run % 3) * 6;
  options.noise_px = noise(rng);
  return test::simulate_views(truth, board, options, rng);
}

TEST(CalibrationUncertainty, TwoHundredCalibrationsAreWhereTheySay) {
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  Hits hits;
  for (unsigned run = 0; run < (test::kSanitized ? 20U : 200U); ++run) {
    const auto solved = solve_intrinsics(640, 480, board, views_of_run(run, truth, board));
    ASSERT_TRUE(solved) << solved.error().message;
    hits.add(*solved, truth);
  }
  hits.expect_honest();
}

// The lens chosen by cross-validation, as `penumbra calibrate` does: one that is simpler than the
// truth is so only where that does not show.
TEST(CalibrationUncertainty, HoldsForTheLensThatIsChosenToo) {
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  Hits hits;
  int without_k3 = 0;
  for (unsigned run = 0; run < (test::kSanitized ? 4U : 40U); ++run) {
    const auto views = views_of_run(run, truth, board);
    const auto start = solve_intrinsics(640, 480, board, views);
    ASSERT_TRUE(start) << start.error().message;
    std::vector<ModelTrial> trials;
    const auto chosen = choose_lens(*start, board, views, {}, BoardShape::rigid, trials);
    ASSERT_TRUE(chosen) << chosen.error().message;
    without_k3 += chosen->without_k3 ? 1 : 0;
    hits.add(chosen->solution, truth);
  }
  std::printf("k3 = 0 in %d\n", without_k3);
  hits.expect_honest();
}

}  // namespace
}  // namespace penumbra
