#include <ceres/covariance.h>
#include <ceres/loss_function.h>
#include <ceres/numeric_diff_cost_function.h>
#include <ceres/problem.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <limits>
#include <tuple>

#include "core/evaluation/evaluation.hpp"
#include "support/synthetic_view.hpp"
#include "tracking/detection/pose_refiner.hpp"
#include "tracking/detection/pose_solver.hpp"

namespace penumbra {
namespace {

using test::desk_camera;
using test::flat_tag;
using test::looking_at_origin;
using test::observe;
using test::points_of;
using test::sheet;

class PoseRefinerLens : public testing::TestWithParam<DistortionModel> {};
INSTANTIATE_TEST_SUITE_P(Lenses, PoseRefinerLens, testing::ValuesIn(kDistortionModels),
                         [](const auto& test) { return std::string(to_string(test.param)); });

TEST_P(PoseRefinerLens, MatchesJacobianToCentralDifferences) {
  const CameraModel camera = test::lens_of(GetParam());
  std::mt19937 random(5);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  for (int i = 0; i < 100; ++i) {
    const CameraPose pose = looking_at_origin(0.5 + 0.2 * unit(random), 0.6 * unit(random),
                                              3.0 * unit(random), 3.0 * unit(random));
    const Eigen::Vector3d p(0.1 * unit(random), 0.1 * unit(random), 0.1 * unit(random));
    const Eigen::Matrix<double, 2, 6> J = reprojection_jacobian(camera, as_map_pose(pose), p);
    for (int axis = 0; axis < 6; ++axis) {
      Vector6d step = Vector6d::Zero();
      step[axis] = 1e-6;
      const Eigen::Vector2d high = camera.project_unchecked(perturbed(pose, step).inverse() * p);
      const Eigen::Vector2d low = camera.project_unchecked(perturbed(pose, -step).inverse() * p);
      EXPECT_LT(((high - low) / 2e-6 - J.col(axis)).norm(), 1e-4 * (1.0 + J.col(axis).norm()));
    }
  }
}

TEST_P(PoseRefinerLens, RecoversExactPoseFromExactCorners) {
  const CameraModel camera = test::lens_of(GetParam());
  std::mt19937 random(6);
  const CameraPose truth = looking_at_origin(0.55, 0.6, 0.4, -0.3);
  for (const auto& tags : {sheet(), std::vector<MappedTag>{flat_tag(0, 0.02, 0.01, 0.08)}}) {
    const auto points = points_of(observe(camera, truth, tags, 0.0, random));
    const auto starts = solve_pose(camera, points);
    ASSERT_FALSE(starts.empty());
    const auto refined = refine_pose(camera, points, starts.front());
    ASSERT_TRUE(refined);
    EXPECT_LT(perturbation_between(as_map_pose(truth), refined->T_map_camera).norm(), 1e-7);
    EXPECT_LT(refined->rms_px, 1e-6);
    EXPECT_GE(refined->noise_px, kCornerNoiseFloor_px);
  }
}

TEST(PoseRefiner, RecoversPerturbationBetweenPoses) {
  const CameraPose pose = looking_at_origin(0.5, 0.4, 1.0, 2.0);
  for (const double size : {0.0, 1e-13, 1e-7, 1e-3, 1.0, 3.0}) {
    Vector6d xi;
    xi << 0.1, -0.2, 0.3, size * 0.48, size * 0.6, size * -0.64;
    const Vector6d back = perturbation_between(pose, perturbed(pose, xi));
    EXPECT_LT((back - xi).norm(), 1e-9) << size;
  }
}

TEST(PoseRefiner, ConvergesFromWrongStart) {
  const CameraModel camera = desk_camera();
  std::mt19937 random(8);
  const CameraPose truth = looking_at_origin(0.5, 0.5, 0.2, 0.1);
  const auto points = points_of(observe(camera, truth, sheet(), 0.0, random));
  Vector6d off;
  off << 0.05, -0.05, 0.1, 0.2, -0.2, 0.3;
  const auto refined = refine_pose(camera, points, as_map_pose(perturbed(truth, off)));
  ASSERT_TRUE(refined);
  EXPECT_LT(perturbation_between(as_map_pose(truth), refined->T_map_camera).norm(), 1e-6);
}

// Both solvers start at the same pose and must reach the same minimum: with noise, with outliers,
// and for one tag or many.
TEST_P(PoseRefinerLens, FindsSameMinimumAsCeres) {
  const CameraModel camera = test::lens_of(GetParam());
  std::mt19937 random(12);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  int compared = 0;
  double worst_px = 0.0;
  for (int i = 0; i < 60; ++i) {
    SCOPED_TRACE(i);
    const CameraPose truth = looking_at_origin(0.5 + 0.2 * unit(random), 0.1 + 0.4 * (i % 3),
                                               3.0 * unit(random), 3.0 * unit(random));
    const std::vector<MappedTag> tags =
        i % 2 == 0 ? sheet() : std::vector<MappedTag>{flat_tag(0, 0.02, 0.01, 0.08)};
    auto points = points_of(observe(camera, truth, tags, 0.3, random));
    if (i % 5 == 0) points[1].pixel += Eigen::Vector2d(12.0, -7.0);
    RefinerOptions by_ceres;
    by_ceres.by_ceres = true;
    for (const MapFromCamera& start : solve_pose(camera, points)) {
      const auto ours = refine_pose(camera, points, start);
      const auto theirs = refine_pose(camera, points, start, by_ceres);
      ASSERT_EQ(ours.has_value(), theirs.has_value());
      if (!ours) continue;
      ++compared;
      const auto T_ours = ours->T_map_camera.inverse();
      const auto T_theirs = theirs->T_map_camera.inverse();
      double cost_ours = 0.0;
      double cost_theirs = 0.0;
      const auto huber = [](double error) {
        return error < 1.0 ? error * error : 2.0 * error - 1.0;
      };
      for (const PointObservation& point : points) {
        const Eigen::Vector2d a = camera.project_unchecked(T_ours * point.p_map);
        const Eigen::Vector2d b = camera.project_unchecked(T_theirs * point.p_map);
        cost_ours += huber((a - point.pixel).norm());
        cost_theirs += huber((b - point.pixel).norm());
        if (i % 5 != 0) worst_px = std::max(worst_px, (a - b).norm());
      }
      // Outliers beyond the loss threshold slow down both solvers; Ceres then stops earlier.
      EXPECT_LT(cost_ours, cost_theirs * (1.0 + 1e-6));
      EXPECT_NEAR(ours->rms_px, theirs->rms_px, i % 5 == 0 ? 5e-3 : 1e-4);
    }
  }
  EXPECT_GE(compared, 60);
  EXPECT_LT(worst_px, 2e-3);  // the cost is flat, so the solvers stop at different poses
  RecordProperty("worst_px", std::to_string(worst_px));
}

// With a correct covariance, the normalised error squared of 6 parameters has mean 6. The refiner
// estimates the variance from f = 2n - 6 residuals and takes the upper end of its confidence
// interval, so the mean is 6 f / (f - 2) / (1 + sqrt(2 / f)).
TEST(PoseRefiner, PredictsCovarianceOfTrials) {
  const CameraModel camera = desk_camera();
  std::mt19937 random(9);
  for (const double noise : {0.3, 0.8}) {
    double sum = 0.0;
    constexpr int kTrials = 400;
    for (int i = 0; i < kTrials; ++i) {
      const CameraPose truth = looking_at_origin(0.55, 0.5, 0.01 * i, -0.02 * i);
      const auto points = points_of(observe(camera, truth, sheet(), noise, random));
      RefinerOptions options;
      options.robust_scale_px = 100.0;  // the noise is Gaussian: no robust loss needed
      const auto refined = refine_pose(camera, points, as_map_pose(truth), options);
      ASSERT_TRUE(refined);
      const Vector6d error = perturbation_between(refined->T_map_camera, as_map_pose(truth));
      sum += error.dot(refined->covariance.inverse() * error);
    }
    constexpr double kFreedom = 2 * 48 - 6;
    const double expected = 6.0 * kFreedom / (kFreedom - 2.0) / (1.0 + std::sqrt(2.0 / kFreedom));
    // The standard deviation over 400 trials is sqrt(2 * 6 / 400) = 0.17; the tolerance is four
    // standard deviations.
    EXPECT_NEAR(sum / kTrials, expected, 0.7) << noise;
  }
}

// Reprojection residual of one point, which Ceres differentiates numerically.
struct Reprojection {
  const CameraModel& camera;
  const MapFromCamera& pose;
  const PointObservation& point;
  bool operator()(const double* xi, double* residual) const {
    const MapFromCamera moved = perturbed(pose, Eigen::Map<const Vector6d>(xi));
    Eigen::Map<Eigen::Vector2d>{residual} =
        camera.project_unchecked(moved.inverse() * point.p_map) - point.pixel;
    return true;
  }
};

TEST_P(PoseRefinerLens, FindsSameCovarianceAsCeres) {
  const CameraModel camera = test::lens_of(GetParam());
  std::mt19937 random(11);
  for (const auto& tags : {sheet(), std::vector<MappedTag>{flat_tag(0, 0.02, 0.01, 0.08)}}) {
    for (int i = 0; i < 5; ++i) {
      const CameraPose truth = looking_at_origin(0.45, 0.8, 0.1 * i, -0.2 * i);
      const auto points = points_of(observe(camera, truth, tags, 0.2, random));
      RefinerOptions options;
      options.robust_scale_px = 2.0;  // Gaussian noise never exceeds it
      const auto refined = refine_pose(camera, points, as_map_pose(truth), options);
      ASSERT_TRUE(refined);
      Vector6d xi = Vector6d::Zero();
      ceres::Problem problem;
      for (const PointObservation& point : points) {
        problem.AddResidualBlock(
            new ceres::NumericDiffCostFunction<Reprojection, ceres::CENTRAL, 2, 6>(
                new Reprojection{camera, refined->T_map_camera, point}),
            new ceres::HuberLoss(options.robust_scale_px), xi.data());
      }
      ceres::Covariance::Options how;
      how.algorithm_type = ceres::DENSE_SVD;
      ceres::Covariance covariance(how);
      ASSERT_TRUE(covariance.Compute(std::vector<const double*>{xi.data()}, &problem));
      Eigen::Matrix<double, 6, 6, Eigen::RowMajor> of_ceres;
      ASSERT_TRUE(covariance.GetCovarianceBlock(xi.data(), xi.data(), of_ceres.data()));
      // Ceres' cost is half of the sum of squares, here in units of the residuals' variance.
      double cost = 0.0;
      ASSERT_TRUE(problem.Evaluate({}, &cost, nullptr, nullptr, nullptr));
      const double freedom = 2.0 * static_cast<double>(points.size()) - 6.0;
      const double variance = std::max(2.0 * cost / freedom, std::pow(kCornerNoiseFloor_px, 2));
      const Matrix6d expected = variance * (1.0 + std::sqrt(2.0 / freedom)) * of_ceres;
      // Compares each entry in units of the standard deviations of its two parameters.
      const Vector6d sigma = expected.diagonal().cwiseSqrt();
      const Matrix6d apart = sigma.cwiseInverse().asDiagonal() * (refined->covariance - expected) *
                             sigma.cwiseInverse().asDiagonal();
      EXPECT_LT(apart.cwiseAbs().maxCoeff(), 1e-4);
    }
  }
}

TEST(PoseRefiner, PredictsErrorOfFewCornersConservatively) {
  const CameraModel camera = desk_camera();
  std::mt19937 random(10);
  const std::vector<MappedTag> one = {flat_tag(0, 0.0, 0.0, 0.06)};
  double error2 = 0.0;
  double predicted2 = 0.0;
  for (int i = 0; i < 300; ++i) {
    const CameraPose truth = looking_at_origin(0.4, 0.8, 0.02 * i, 0.01 * i);
    const auto points = points_of(observe(camera, truth, one, 0.3, random));
    const auto refined = refine_pose(camera, points, as_map_pose(truth));
    ASSERT_TRUE(refined);
    const double e = overlay_difference(camera, refined->T_map_camera, as_map_pose(truth)).rms_px();
    const double p = predicted_overlay_error_px(camera, refined->T_map_camera, refined->covariance);
    error2 += e * e;
    predicted2 += p * p;
  }
  EXPECT_LT(std::sqrt(error2 / predicted2), 1.15);
  EXPECT_GT(std::sqrt(error2 / predicted2), 0.4) << "the prediction is far too large";
}

TEST(PoseRefiner, RejectsDegenerateInput) {
  const CameraModel camera = desk_camera();
  std::mt19937 random(11);
  const CameraPose truth = looking_at_origin(0.5, 0.3, 0.0, 0.0);
  auto points = points_of(observe(camera, truth, sheet(), 0.0, random));
  EXPECT_FALSE(refine_pose(camera, {}, as_map_pose(truth)));
  EXPECT_FALSE(refine_pose(camera, std::span(points).first(2), as_map_pose(truth)));
  // The points are behind the camera.
  EXPECT_FALSE(refine_pose(
      camera, points, MapFromCamera(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0, 0, 0.5))));
  // Points on one line do not determine a pose.
  std::vector<PointObservation> line;
  for (int i = 0; i < 6; ++i) {
    const Eigen::Vector3d p(0.02 * i, 0.01 * i, 0.0);
    line.push_back({p, *camera.project(truth.inverse() * p)});
  }
  EXPECT_FALSE(refine_pose(camera, line, as_map_pose(truth)));
  points[3].pixel.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(refine_pose(camera, points, as_map_pose(truth)));
}

TEST(PoseSolver, FindsBothPosesOfSmallTag) {
  const CameraModel camera = desk_camera();
  std::mt19937 random(12);
  int both = 0;
  int truth_among_them = 0;
  constexpr int kTrials = 100;
  for (int i = 0; i < kTrials; ++i) {
    const CameraPose truth = looking_at_origin(0.9, radians(20.0), 0.06 * i, 0.1);
    const auto points =
        points_of(observe(camera, truth, {flat_tag(0, 0.0, 0.0, 0.04)}, 0.1, random));
    const auto starts = solve_pose(camera, points);
    both += starts.size() == 2 ? 1 : 0;
    bool close = false;
    for (const MapFromCamera& start : starts)
      close = close || start.rotation().angularDistance(truth.rotation()) < radians(8.0);
    truth_among_them += close ? 1 : 0;
  }
  EXPECT_EQ(both, kTrials);
  EXPECT_GE(truth_among_them, 95);
}

TEST(PoseSolver, FindsOnePoseForNonPlanarPoints) {
  const CameraModel camera = desk_camera();
  std::mt19937 random(13);
  std::vector<MappedTag> tags = sheet();
  for (int i = 0; i < 3; ++i) {
    MappedTag upright = flat_tag(30 + i, 0.0, 0.0, 0.06);
    upright.T_table_tag = {
        Eigen::Quaterniond(Eigen::AngleAxisd(radians(90.0), Eigen::Vector3d::UnitX())),
        Eigen::Vector3d(-0.08 + 0.08 * i, 0.12, 0.08)};
    tags.push_back(upright);
  }
  const CameraPose truth = looking_at_origin(0.6, 0.9, 0.1, 0.0);
  const auto starts = solve_pose(camera, points_of(observe(camera, truth, tags, 0.0, random)));
  ASSERT_EQ(starts.size(), 1U);
  EXPECT_LT(perturbation_between(as_map_pose(truth), starts[0]).norm(), 1e-4);
}

TEST(PoseSolver, FindsNoPoseForDegenerateInput) {
  const CameraModel camera = desk_camera();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  std::mt19937 random(14);
  const CameraPose truth = looking_at_origin(0.5, 0.3, 0.0, 0.0);
  const auto points = points_of(observe(camera, truth, {flat_tag(0, 0.0, 0.0, 0.05)}, 0.0, random));
  EXPECT_TRUE(solve_pose(camera, {}).empty());
  for (const std::size_t count : {1U, 2U, 3U})
    EXPECT_TRUE(solve_pose(camera, std::span(points).first(count)).empty());
  std::vector<PointObservation> line;
  for (int i = 0; i < 8; ++i) {
    const Eigen::Vector3d p(0.02 * i - 0.08, 0.01 * i, 0.0);
    line.push_back({p, *camera.project(truth.inverse() * p)});
  }
  EXPECT_TRUE(solve_pose(camera, line).empty());
  EXPECT_TRUE(solve_pose(camera, std::vector<PointObservation>(4, points[0])).empty());
  auto bad = points;
  bad[1].pixel.y() = nan;
  EXPECT_TRUE(solve_pose(camera, bad).empty());
  bad = points;
  bad[2].p_map.x() = nan;
  EXPECT_TRUE(solve_pose(camera, bad).empty());
}

}  // namespace
}  // namespace penumbra
