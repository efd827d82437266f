#include "core/camera/camera_model.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <tuple>

#include "core/units.hpp"
#include "support/cameras.hpp"

namespace penumbra {
namespace {

CameraParameters base() {
  return test::desk_camera().parameters();
}

void expect_jacobian_of_differences(const CameraModel& camera, const Eigen::Vector3d& p) {
  Eigen::Matrix<double, 2, 3> J;
  std::ignore = camera.project_unchecked(p, &J);
  for (int axis = 0; axis < 3; ++axis) {
    Eigen::Vector3d step = Eigen::Vector3d::Zero();
    step[axis] = 1e-6;
    const Eigen::Vector2d difference =
        (camera.project_unchecked(p + step) - camera.project_unchecked(p - step)) / 2e-6;
    EXPECT_LT((difference - J.col(axis)).norm(), 1e-5 * (1.0 + J.norm()));
  }
}

class CameraProjection : public testing::TestWithParam<DistortionModel> {};
INSTANTIATE_TEST_SUITE_P(Models, CameraProjection, testing::ValuesIn(kDistortionModels),
                         [](const auto& instance) {
                           return std::string(to_string(instance.param));
                         });

TEST_P(CameraProjection, UnprojectInvertsProject) {
  const CameraModel camera = test::lens_of(GetParam());
  for (double v = -20.0; v <= 500.0; v += 13.0) {
    for (double u = -20.0; u <= 660.0; u += 17.0) {
      const auto ray = camera.unproject({u, v});
      ASSERT_TRUE(ray) << u << " " << v;
      const auto pixel = camera.project(*ray * 0.7);
      ASSERT_TRUE(pixel);
      EXPECT_LT((*pixel - Eigen::Vector2d(u, v)).norm(), 1e-7);
    }
  }
}

TEST_P(CameraProjection, JacobianMatchesCentralDifferences) {
  const CameraModel camera = test::lens_of(GetParam());
  std::mt19937 random(7);
  std::uniform_real_distribution<double> across(-0.5, 0.5);
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d p(across(random), across(random), 0.8 + across(random) * 0.5);
    expect_jacobian_of_differences(camera, p);
  }
}

// A strong fisheye lens with all four coefficients, up to 80 degrees from the axis.
TEST(CameraModel, ProjectsStrongFisheyeExactlyToRim) {
  CameraParameters p = base();
  p.fx = p.fy = 0.35 * p.width;
  p.model = DistortionModel::fisheye;
  p.distortion = {-0.04, 0.012, -0.006, 0.001};
  const CameraModel camera = CameraModel::make(p).value();
  ASSERT_GT(camera.max_radius(), std::tan(radians(80.0)));
  std::mt19937 random(9);
  std::uniform_real_distribution<double> u(0.0, 1.0);
  for (int i = 0; i < 500; ++i) {
    const double theta = radians(80.0 * u(random));
    const double phi = radians(360.0 * u(random));
    const double depth = 0.2 + u(random);
    const Eigen::Vector3d point = depth * Eigen::Vector3d(std::tan(theta) * std::cos(phi),
                                                          std::tan(theta) * std::sin(phi), 1.0);
    // The fisheye formula, in angles.
    const double t2 = theta * theta;
    const double theta_d = theta * (1.0 + t2 * (-0.04 + t2 * (0.012 + t2 * (-0.006 + t2 * 0.001))));
    const Eigen::Vector2d expected(p.fx * theta_d * std::cos(phi) + p.cx,
                                   p.fy * theta_d * std::sin(phi) + p.cy);
    const auto pixel = camera.project(point);
    ASSERT_TRUE(pixel);
    EXPECT_LT((*pixel - expected).norm(), 1e-9);
    const auto ray = camera.unproject(*pixel);
    ASSERT_TRUE(ray);
    EXPECT_LT((*ray - point / depth).norm(), 1e-8 * (1.0 + ray->squaredNorm()));
    expect_jacobian_of_differences(camera, point);
  }
}

TEST(CameraModel, RejectsPointsBehindCameraAndNonFinite) {
  const CameraModel camera = CameraModel::make(base()).value();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(camera.project({0.0, 0.0, 0.0}));
  EXPECT_FALSE(camera.project({0.0, 0.0, -1.0}));
  EXPECT_FALSE(camera.project({nan, 0.0, 1.0}));
  EXPECT_FALSE(camera.unproject({nan, 0.0}));
  EXPECT_FALSE(camera.project_extended({0.0, 0.0, -1.0}));
}

TEST(CameraModel, LimitsRadiusToMonotonicRange) {
  CameraParameters p = base();
  p.distortion = {-0.28, 0.0, 0.0, 0.0, 0.0};
  const CameraModel camera = CameraModel::make(p).value();
  // d/dr (r + k1 r^3) = 0 at r = 1 / sqrt(-3 k1)
  EXPECT_NEAR(camera.max_radius(), 1.0 / std::sqrt(3.0 * 0.28), 1e-4);
  EXPECT_FALSE(camera.project({1.2, 0.0, 1.0}));
  EXPECT_TRUE(camera.project_extended({1.2, 0.0, 1.0}));
  const double far = camera.project_extended({3.0, 0.0, 1.0})->x();
  const double near = camera.project_extended({2.0, 0.0, 1.0})->x();
  EXPECT_GT(far, near) << "beyond the monotonic range, points farther out must project farther out";
  // Rounding must not hide the radius where the projection stops increasing, at any distance.
  for (int i = 0; i < 2000; ++i) {
    const double x = 1.1 + 0.37 * i;
    EXPECT_TRUE(camera.project_extended({x, 0.731 * x, 1.0})) << x;
  }
  // A pixel beyond the largest distorted radius has no ray.
  EXPECT_FALSE(camera.unproject({p.cx + 0.75 * p.fx, p.cy}));
}

TEST(CameraModel, MatchesOpenCvFormulaAtPoint) {
  const CameraModel camera = CameraModel::make(base()).value();
  const double x = 0.3;
  const double y = -0.2;
  const double r2 = x * x + y * y;
  const double radial = 1.0 - 0.215 * r2 + 0.062 * r2 * r2 - 0.004 * r2 * r2 * r2;
  const double xd = x * radial + 2.0 * 0.0008 * x * y - 0.0006 * (r2 + 2.0 * x * x);
  const double yd = y * radial + 0.0008 * (r2 + 2.0 * y * y) - 2.0 * 0.0006 * x * y;
  const auto pixel = camera.project({x, y, 1.0});
  ASSERT_TRUE(pixel);
  EXPECT_NEAR(pixel->x(), 531.7 * xd + 322.3, 1e-9);
  EXPECT_NEAR(pixel->y(), 530.4 * yd + 237.6, 1e-9);
}

TEST(CameraModel, RejectsInvalidParameters) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  auto refuses = [](CameraParameters p, const char* field) {
    const auto camera = CameraModel::make(p);
    ASSERT_FALSE(camera);
    EXPECT_THAT(camera.error().message, testing::HasSubstr(field));
  };
  CameraParameters p = base();
  p.width = 0;
  refuses(p, "image_width");
  p = base();
  p.fx = nan;
  refuses(p, "fx");
  p = base();
  p.fy = -3.0;
  refuses(p, "fy");
  p = base();
  p.cx = std::numeric_limits<double>::infinity();
  refuses(p, "cx");
  p = base();
  p.distortion[3] = nan;
  refuses(p, "p2");
}

}  // namespace
}  // namespace penumbra
