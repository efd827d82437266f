// 200 simulated calibrations: the true projection lies inside the predicted 3 sigma.
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <random>

#include "calib/camera_calibration.hpp"
#include "calib/intrinsics_solver.hpp"
#include "support/calibration_views.hpp"
#include "support/stress_form.hpp"

namespace penumbra {
namespace {

TEST(CalibrationUncertainty, TwoHundredCalibrationsAreWhereTheySay) {
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  int inside = 0;
  int all = 0;
  double chi2 = 0.0;
  for (unsigned run = 0; run < (test::kSanitized ? 20U : 200U); ++run) {
    std::mt19937 rng(1000 + run);
    std::uniform_real_distribution<double> noise(0.03, 0.4);
    test::ViewOptions options;
    options.views = 8 + static_cast<int>(run % 3) * 6;
    options.noise_px = noise(rng);
    const auto views = test::simulate_views(truth, board, options, rng);
    const auto solved = solve_intrinsics(640, 480, board, views);
    ASSERT_TRUE(solved) << solved.error().message;
    for (int j = 0; j < 12; ++j) {
      for (int i = 0; i < 16; ++i) {
        const Eigen::Vector2d pixel((i + 0.5) * 40.0, (j + 0.5) * 40.0);
        const auto direction = solved->camera.unproject(pixel);
        const auto covariance = projection_covariance(solved->camera, solved->covariance, pixel);
        ++all;
        if (!direction || !covariance) continue;
        const Eigen::Vector2d error = truth.project_unchecked(*direction) - pixel;
        const double squared = error.dot(covariance->inverse() * error);
        chi2 += squared;
        if (squared <= 9.0) ++inside;
      }
    }
  }
  RecordProperty("inside_percent", std::to_string(100.0 * inside / all));
  std::printf(
      "inside 3 sigma: %.2f %% of %d image points; mean squared error over predicted: %.2f\n",
      100.0 * inside / all, all, chi2 / (2.0 * all));
  EXPECT_GE(inside, 0.95 * all);
  EXPECT_GT(chi2 / (2.0 * all), 0.3) << "the prediction is too wide to say anything";
}

}  // namespace
}  // namespace penumbra
