#include "tracking/motion/motion_model.hpp"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>

#include <cmath>
#include <random>

#include "core/units.hpp"

namespace penumbra {
namespace {

constexpr std::int64_t kFrame_ns = 33'333'333;

Matrix6d measurement_covariance(double sigma_m, double sigma_rad) {
  Matrix6d P = Matrix6d::Zero();
  P.diagonal().head<3>().setConstant(sigma_m * sigma_m);
  P.diagonal().tail<3>().setConstant(sigma_rad * sigma_rad);
  return P;
}

TEST(MotionModel, PredictsSteadyMotionWithoutDrift) {
  Vector6d velocity;
  velocity << 0.2, -0.1, 0.05, 0.3, 0.2, -0.4;
  MapFromCamera pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.0, 0.0, 0.5));
  MotionModel motion;
  motion.start(0, pose, measurement_covariance(1e-4, 1e-4));
  double error_m = 0.0;
  double error_rad = 0.0;
  for (int k = 1; k <= 10'000; ++k) {
    pose = perturbed(pose, velocity * seconds(kFrame_ns));
    const MotionPrediction prediction = motion.predict(k * kFrame_ns);
    const Vector6d off = perturbation_between(prediction.T_map_camera, pose);
    if (k > 50) {
      error_m = std::max(error_m, off.head<3>().norm());
      error_rad = std::max(error_rad, off.tail<3>().norm());
    }
    motion.update(k * kFrame_ns, pose, measurement_covariance(1e-4, 1e-4));
    ASSERT_NEAR(prediction.T_map_camera.rotation().norm(), 1.0, 1e-12);
  }
  EXPECT_LT(error_m, 1e-4);
  EXPECT_LT(error_rad, 1e-4);
}

TEST(MotionModel, WidensCovarianceAfterJerk) {
  MapFromCamera pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.0, 0.0, 0.5));
  MotionModel motion;
  motion.start(0, pose, measurement_covariance(2e-4, 5e-4));
  std::mt19937_64 random(2);
  std::normal_distribution<double> n(0.0, 1.0);
  const auto noisy = [&](const MapFromCamera& p) {
    Vector6d xi;
    for (int k = 0; k < 6; ++k) xi[k] = (k < 3 ? 2e-4 : 5e-4) * n(random);
    return perturbed(p, xi);
  };
  for (int k = 1; k <= 60; ++k)
    motion.update(k * kFrame_ns, noisy(pose), measurement_covariance(2e-4, 5e-4));
  const double rest = std::sqrt(motion.predict(61 * kFrame_ns).covariance(0, 0));
  EXPECT_LT(rest, 0.001);
  Vector6d jerk = Vector6d::Zero();
  jerk[0] = 0.02;
  pose = perturbed(pose, jerk);
  motion.update(61 * kFrame_ns, pose, measurement_covariance(2e-4, 5e-4));
  EXPECT_GT(std::sqrt(motion.predict(62 * kFrame_ns).covariance(0, 0)), 0.005);
}

TEST(MotionModel, KeepsCovariancePositiveDefinite) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> n(0.0, 1.0);
  MapFromCamera pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.0, 0.0, 0.5));
  MotionModel motion;
  motion.start(0, pose, measurement_covariance(1e-3, 1e-2));
  for (int k = 1; k <= 2'000; ++k) {
    const MotionPrediction prediction = motion.predict(k * kFrame_ns);
    const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(prediction.covariance);
    ASSERT_GT(eigen.eigenvalues().minCoeff(), 0.0) << "frame " << k;
    // The image always adds information, so the posterior covariance is smaller than the
    // prediction's.
    const Matrix6d image = measurement_covariance(std::pow(10.0, -3.0 + n(random)), 1e-3).inverse();
    const Matrix6d posterior = (prediction.covariance.inverse() + image).inverse();
    Vector6d xi;
    for (int i = 0; i < 6; ++i) xi[i] = 0.003 * n(random);
    motion.update(k * kFrame_ns, perturbed(prediction.T_map_camera, xi), posterior);
  }
}

}  // namespace
}  // namespace penumbra
