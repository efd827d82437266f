// The predicted error of corners over the table, compared with the actual error.
#include "calib/solver/table_volume.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <random>

#include "calib/solver/intrinsics_solver.hpp"
#include "calib/target/target_sheet.hpp"
#include "core/evaluation/evaluation.hpp"
#include "support/calibration_views.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {
namespace {

CameraModel moved_lens(const CameraModel& camera, const Eigen::VectorXd& by) {
  CameraParameters p = camera.parameters();
  p.fx += by[0];
  p.fy += by[1];
  p.cx += by[2];
  p.cy += by[3];
  for (Eigen::Index i = 4; i < by.size(); ++i)
    p.distortion[static_cast<std::size_t>(i - 4)] += by[i];
  return CameraModel::make(p).value();
}

double worst(const Eigen::Matrix2d& squares) {
  return std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(squares).eigenvalues()[1]);
}

TEST(TableVolume, MatchesCubeErrorOfPerturbedLenses) {
  std::mt19937 rng(3);
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  const auto solved = solve_intrinsics(truth.width(), truth.height(), board,
                                       test::simulate_views(truth, board, {}, rng));
  ASSERT_TRUE(solved) << solved.error().message;
  const auto volume = table_volume_uncertainty(truth, solved->covariance);
  ASSERT_TRUE(volume);
  // The nearest distance at which the image contains the whole cube: one corner is close to the
  // border.
  double to_edge = 1e9;
  for (const Eigen::Vector2d& p : volume->corners_px) {
    to_edge =
        std::min({to_edge, p.x(), p.y(), truth.width() - 1 - p.x(), truth.height() - 1 - p.y()});
  }
  EXPECT_GE(to_edge, 2.0);
  EXPECT_LT(to_edge, 12.0);

  const auto T_camera_table = volume->T_table_camera.inverse();
  std::vector<PointObservation> tags;
  const TagMap sheet = tag_map_of(TagBoard()).value();
  for (const MappedTag& tag : sheet.tags()) {
    for (const Eigen::Vector3d& corner : tag.corners()) {
      const auto pixel = truth.project(T_camera_table * corner);
      constexpr double kMargin = 2.0;
      if (!pixel || pixel->x() < kMargin || pixel->y() < kMargin ||
          pixel->x() > truth.width() - 1 - kMargin || pixel->y() > truth.height() - 1 - kMargin)
        continue;  // outside the image
      tags.push_back({corner, *pixel});
    }
  }
  ASSERT_GE(tags.size(), 24U);
  const Eigen::MatrixXd L = solved->covariance.llt().matrixL();
  std::normal_distribution<double> normal;
  const auto cube = overlay_cube();
  std::array<Eigen::Matrix2d, 8> known, tracked;
  known.fill(Eigen::Matrix2d::Zero());
  tracked.fill(Eigen::Matrix2d::Zero());
  constexpr int kTrials = 2000;
  for (int trial = 0; trial < kTrials; ++trial) {
    Eigen::VectorXd d(L.rows());
    for (double& value : d) value = normal(rng);
    const CameraModel wrong = moved_lens(truth, L * d);
    const auto pose = refine_pose(wrong, tags, as_map_pose(volume->T_table_camera));
    ASSERT_TRUE(pose);
    for (std::size_t i = 0; i < cube.size(); ++i) {
      const Eigen::Vector2d a = *wrong.project(T_camera_table * cube[i]) - volume->corners_px[i];
      const Eigen::Vector2d b =
          *wrong.project(pose->T_map_camera.inverse() * cube[i]) - volume->corners_px[i];
      known[i] += a * a.transpose() / kTrials;
      tracked[i] += b * b.transpose() / kTrials;
    }
  }
  for (std::size_t i = 0; i < cube.size(); ++i) {
    EXPECT_NEAR(worst(known[i]) / volume->known_pose_px[i], 1.0, 0.1) << i;
    EXPECT_NEAR(worst(tracked[i]) / volume->tracked_px[i], 1.0, 0.1) << i;
  }
  EXPECT_GT(volume->largest_tracked_px(), 0.0);
}

TEST(TableVolume, IsEmptyWhenCubeNeverFitsImage) {
  CameraParameters p = test::desk_camera().parameters();
  p.fx *= 40.0;
  p.fy *= 40.0;
  p.distortion = {};
  const Eigen::MatrixXd covariance = Eigen::MatrixXd::Identity(9, 9);
  EXPECT_FALSE(table_volume_uncertainty(CameraModel::make(p).value(), covariance));
}

}  // namespace
}  // namespace penumbra
