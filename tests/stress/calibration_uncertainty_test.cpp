// Simulated calibrations: the true projection lies within the predicted 3 sigma. The nightly form
// runs 200 of them.
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <array>
#include <cmath>
#include <cstdlib>
#include <random>

#include "calib/camera_calibration.hpp"
#include "support/calibration_views.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

// Compares the errors of image points with their predicted covariances.
struct Hits {
  int inside = 0;     // points with an error within 3 sigma
  int all = 0;        // all points
  double chi2 = 0.0;  // sum of squared errors, in units of the predicted covariance

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
  void expect_consistent() const {
    std::printf(
        "inside 3 sigma: %.2f %% of %d image points; mean squared error over predicted: %.2f\n",
        100.0 * inside / all, all, chi2 / (2.0 * all));
    EXPECT_GE(inside, 0.95 * all);
    EXPECT_GT(chi2 / (2.0 * all), 0.3) << "the predicted covariance is far too large";
  }
};

unsigned runs(unsigned nightly, unsigned short_form, unsigned sanitized) {
  return test::nightly() ? nightly : test::kSanitized ? sanitized : short_form;
}

std::vector<CalibrationView> views_of_run(unsigned run, const CameraModel& truth,
                                          const std::vector<Eigen::Vector3d>& board) {
  std::mt19937 rng(1000 + run);
  std::uniform_real_distribution<double> noise(0.03, 0.4);
  test::ViewOptions options;
  options.views = 8 + static_cast<int>(run % 3) * 6;
  options.noise_px = noise(rng);
  return test::simulate_views(truth, board, options, rng);
}

// The short forms have a run for each number of views. If one of their runs were wrong everywhere,
// at least 16 % of the points would lie outside 3 sigma, more than the allowed 5 %.
TEST(CalibrationUncertainty, PredictsProjectionErrorOfSimulatedCalibrations) {
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  Hits hits;
  for (unsigned run = 0; run < runs(200, 6, 6); ++run) {
    const auto solved = solve_intrinsics(640, 480, board, views_of_run(run, truth, board));
    ASSERT_TRUE(solved) << solved.error().message;
    hits.add(*solved, truth);
  }
  hits.expect_consistent();
}

// Cross-validation chooses the lens model, as in `penumbra calibrate`. The model may be simpler
// than the true one only if the difference is negligible.
TEST(CalibrationUncertainty, PredictsProjectionErrorOfChosenLensModel) {
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  Hits hits;
  int without_k3 = 0;
  for (unsigned run = 0; run < runs(40, 3, 3); ++run) {
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
  hits.expect_consistent();
}

struct Lens {
  const char* name;
  CameraModel camera;
  double distance_m;  // distance at which the board fills a third of the image
};

CameraModel plumb_bob(double f, std::array<double, 8> distortion) {
  CameraParameters p = test::desk_camera().parameters();
  p.fx = f;
  p.fy = 0.998 * f;
  p.distortion = distortion;
  return CameraModel::make(p).value();
}

// The verdict on a wrong calibration must never be good, for any lens and any views of the board.
// `coverage` is the fraction of the image that the views cover. The nightly form runs each
// combination of lens, coverage and noise three times. The short form runs one combination per
// lens; together these have every coverage and every noise.
TEST(CalibrationVerdict, IsNeverGoodForWrongLens) {
  const Lens lenses[] = {
      {"plumb_bob", plumb_bob(531.0, {-0.215, 0.062, 0.0008, -0.0006, -0.004}), 0.4},
      {"plumb_bob, strong", plumb_bob(480.0, {-0.33, 0.15, 0.0005, -0.0003, -0.035}), 0.35},
      {"rational, wide", test::rational_lens(), 0.25},
      {"rational, 1280 x 720", test::rational_lens(1280, 720), 0.25},
      {"equidistant", test::wide_lens(), 0.18}};
  const bool nightly = test::nightly();
  const auto board = test::flat_board();
  int good = 0;
  int cases = 0;  // 6 of each lens
  for (const Lens& lens : lenses) {
    for (const double coverage : {0.95, 0.6, 0.35}) {
      for (const double noise_px : {0.05, 0.2}) {
        const int i = cases++;
        const int lens_index = i / 6;
        if (!nightly && (i % 6 / 2 != 2 * lens_index % 3 || i % 2 != lens_index % 2)) continue;
        for (unsigned run = 0; run < (nightly ? 3U : 1U); ++run) {
          const int width = lens.camera.width();
          const int height = lens.camera.height();
          std::mt19937 rng(500 + run);
          const auto views = test::simulate_views(lens.camera, board,
                                                  {.views = 14,
                                                   .noise_px = noise_px,
                                                   .distance_m = lens.distance_m,
                                                   .coverage = coverage},
                                                  rng);
          const auto start = first_solution(width, height, board, views, {});
          if (!start) continue;  // the calibration was rejected
          CameraCalibration c;
          const auto chosen = choose_lens(*start, board, views, {}, std::nullopt, c.trials);
          if (!chosen) continue;
          c.solution = chosen->solution;
          c.held_out_px = chosen->held_out_px;
          for (std::size_t v = 0; v < views.size(); ++v) {
            CalibrationImage image;
            image.solved = static_cast<int>(v);
            image.view.corners = views[v].corners;
            c.images.push_back(std::move(image));
          }
          judge(c);
          if (c.grade != CalibrationGrade::good) continue;
          ++good;
          const double wrong = projection_difference(lens.camera, c.solution.camera).mean_px;
          EXPECT_LT(wrong, 1.0) << lens.name << ", coverage " << coverage << ", run " << run;
          EXPECT_LT(wrong, 3.0 * c.uncertainty.mean_px)
              << lens.name << ", coverage " << coverage << ", run " << run;
        }
      }
    }
  }
  std::printf("good: %d\n", good);
  EXPECT_GE(good, nightly ? 6 : 1) << "the verdict must be good for some calibrations";
}

}  // namespace
}  // namespace penumbra
