#include "core/evaluation/pose_convention_hint.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <functional>
#include <limits>
#include <random>

#include "core/units.hpp"

namespace penumbra {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::StartsWith;

constexpr int kTrajectories = 300;  // trajectories per property

double uniform(std::mt19937& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}

Eigen::Vector3d direction(std::mt19937& random) {
  std::normal_distribution<double> normal;
  return Eigen::Vector3d(normal(random), normal(random), normal(random)).normalized();
}

Eigen::Quaterniond turn(std::mt19937& random, double largest_rad) {
  return Eigen::Quaterniond(
      Eigen::AngleAxisd(uniform(random, -largest_rad, largest_rad), direction(random)));
}

// A camera that moves over the table at 0.2 to 2 m and looks roughly at the origin. Views from
// straight above are excluded, because some of these poses nearly equal their inverse.
Trajectory random_trajectory(std::mt19937& random) {
  Trajectory trajectory;
  const double distance_m = uniform(random, 0.2, 2.0);
  double azimuth = uniform(random, -3.0, 3.0);
  double elevation = uniform(random, 0.3, 1.0);
  for (int i = 0; i < 30; ++i) {
    azimuth += uniform(random, -0.02, 0.03);
    elevation += uniform(random, -0.01, 0.01);
    const Eigen::Vector3d to_camera(std::cos(elevation) * std::cos(azimuth),
                                    std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
    const Eigen::Vector3d z = -to_camera;
    const Eigen::Vector3d x = z.cross(Eigen::Vector3d::UnitZ()).normalized();
    Eigen::Matrix3d R;
    R << x, z.cross(x), z;
    const Eigen::Quaterniond rotation = Eigen::Quaterniond(R) * turn(random, 0.05);
    trajectory.poses.push_back({i * 33'333'333LL, {rotation, distance_m * to_camera}, {}});
  }
  return trajectory;
}

using Change = std::function<CameraPose(const CameraPose&)>;

Trajectory changed(Trajectory trajectory, const Change& change) {
  for (StampedPose& pose : trajectory.poses) pose.T_table_camera = change(pose.T_table_camera);
  return trajectory;
}

CameraPose in_millimetres(const CameraPose& pose) {
  return {pose.rotation(), 1000.0 * pose.translation()};
}
// Misreads a quaternion written as w x y z as x y z w.
CameraPose w_first(const CameraPose& pose) {
  const Eigen::Quaterniond& q = pose.rotation();
  return {Eigen::Quaterniond(q.z(), q.w(), q.x(), q.y()), pose.translation()};
}
CameraPose inverted(const CameraPose& pose) {
  return {pose.inverse().rotation(), pose.inverse().translation()};
}

using FrameOffset = Transform<frame::Table, frame::Table>;

Change moved_by(const FrameOffset& T_new_old) {
  return [=](const CameraPose& pose) { return T_new_old * pose; };
}

// An estimate of the trajectory with translation errors of up to `error` of the distance and
// rotation errors of up to `error` rad.
Trajectory estimate_of(const Trajectory& truth, double error, std::mt19937& random) {
  return changed(truth, [&](const CameraPose& pose) {
    const double distance_m = pose.translation().norm();
    return CameraPose(
        pose.rotation() * turn(random, error),
        pose.translation() + uniform(random, 0.0, error) * distance_m * direction(random));
  });
}

std::string hint_for(const Trajectory& estimated, const Trajectory& truth) {
  return pose_convention_hint({estimated, "est.tum"}, {truth, "truth.tum"}, {}).value_or("");
}

TEST(PoseConventionHint, IsEmptyForCorrectTruth) {
  std::mt19937 random(1);
  for (int i = 0; i < kTrajectories; ++i) {
    const Trajectory truth = random_trajectory(random);
    for (const double error : {0.0, 0.005, 0.1, 1.0})
      EXPECT_EQ(hint_for(estimate_of(truth, error, random), truth), "") << i << " " << error;
  }
}

TEST(PoseConventionHint, IsEmptyForUnrelatedTrajectories) {
  std::mt19937 random(2);
  for (int i = 0; i < kTrajectories; ++i) {
    const Trajectory truth = random_trajectory(random);
    EXPECT_EQ(hint_for(random_trajectory(random), truth), "") << i;
  }
}

TEST(PoseConventionHint, ReportsConvention) {
  struct Case {
    Change change;
    std::vector<const char*> words;
  };
  const std::vector<Case> cases = {
      {in_millimetres, {"positions in millimetres", "give positions in metres"}},
      {w_first, {"the order w x y z", "give quaternions as qx qy qz qw"}},
      {inverted, {"inverse poses (T_camera_table)", "give T_table_camera"}},
      {[](const CameraPose& pose) { return in_millimetres(w_first(pose)); },
       {"millimetres and quaternions in the order w x y z"}},
      {[](const CameraPose& pose) { return in_millimetres(inverted(pose)); },
       {"millimetres and inverse poses"}},
      {[](const CameraPose& pose) { return w_first(inverted(pose)); },
       {"the order w x y z and inverse poses"}}};
  std::mt19937 random(3);
  for (const Case& c : cases) {
    for (int i = 0; i < kTrajectories; ++i) {
      const Trajectory truth = random_trajectory(random);
      const Trajectory estimated = estimate_of(truth, 0.004, random);
      const std::string hint = hint_for(estimated, changed(truth, c.change));
      EXPECT_THAT(hint, AllOf(StartsWith("truth.tum: the ground truth looks like"),
                              HasSubstr("Nothing was changed")));
      for (const char* words : c.words) EXPECT_THAT(hint, HasSubstr(words)) << i;
    }
  }
}

TEST(PoseConventionHint, ReportsWrongUnitOrQuaternionOrderOfEstimate) {
  std::mt19937 random(4);
  for (int i = 0; i < kTrajectories; ++i) {
    const Trajectory truth = random_trajectory(random);
    const Trajectory estimated = estimate_of(truth, 0.004, random);
    for (const Change& change : {Change(in_millimetres), Change(w_first)}) {
      EXPECT_THAT(hint_for(changed(estimated, change), truth),
                  StartsWith("est.tum: the estimate looks like"))
          << i;
    }
  }
}

TEST(PoseConventionHint, ReportsOtherTableFrame) {
  std::mt19937 random(6);
  for (int i = 0; i < kTrajectories; ++i) {
    const Trajectory truth = random_trajectory(random);
    const Eigen::Vector3d shift = uniform(random, 0.05, 2.0) * direction(random);
    const double angle = uniform(random, 0.3, 3.0);
    const FrameOffset T_truth_estimate(
        Eigen::Quaterniond(Eigen::AngleAxisd(angle, direction(random))), shift);
    const Trajectory estimated =
        changed(estimate_of(truth, 1e-4, random), moved_by(T_truth_estimate.inverse()));
    const std::string hint = hint_for(estimated, truth);
    EXPECT_THAT(hint, StartsWith("truth.tum: the ground truth and the estimate have different"))
        << i;
    double mm = 0.0;
    double deg = 0.0;
    const std::size_t numbers = hint.find("frames: ");
    ASSERT_NE(numbers, std::string::npos);
    ASSERT_EQ(std::sscanf(hint.c_str() + numbers, "frames: %lf mm between their origins and %lf",
                          &mm, &deg),
              2);
    EXPECT_NEAR(mm, 1e3 * shift.norm(), 1.0) << i;
    EXPECT_NEAR(deg, degrees(angle), 0.05) << i;
  }
}

TEST(PoseConventionHint, IsEmptyForOffsetOfCamera) {
  std::mt19937 random(7);
  for (int i = 0; i < kTrajectories; ++i) {
    const Trajectory truth = random_trajectory(random);
    const Transform<frame::Camera, frame::Camera> offset(turn(random, 0.2),
                                                         0.1 * direction(random));
    EXPECT_EQ(
        hint_for(changed(truth, [&](const CameraPose& pose) { return pose * offset; }), truth), "")
        << i;
  }
}

TEST(PoseConventionHint, IsEmptyForSmallOffsetOrFewPoses) {
  std::mt19937 random(8);
  for (int i = 0; i < kTrajectories; ++i) {
    Trajectory truth = random_trajectory(random);
    const Eigen::Vector3d shift = direction(random);
    const auto shifted_by = [&](double metres) {
      return changed(truth,
                     moved_by({Eigen::Quaterniond::Identity(), Eigen::Vector3d(metres * shift)}));
    };
    EXPECT_EQ(hint_for(shifted_by(0.001), truth), "") << i;
    EXPECT_NE(hint_for(shifted_by(0.1), truth), "") << i;
    truth.poses.resize(4);
    EXPECT_EQ(hint_for(shifted_by(0.1), truth), "") << i;
  }
}

TEST(PoseConventionHint, IgnoresPosesThatAreNotFinite) {
  std::mt19937 random(9);
  for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    const Trajectory truth = random_trajectory(random);
    Trajectory estimated = changed(truth, moved_by({turn(random, 1.0), direction(random)}));
    EXPECT_NE(hint_for(estimated, truth), "");
    for (const std::size_t i : {0, 7, 29}) {
      CameraPose& pose = estimated.poses[i].T_table_camera;
      pose = CameraPose(pose.rotation(), Eigen::Vector3d(0.0, bad, 0.0));
    }
    EXPECT_NE(hint_for(estimated, truth), "");
    for (StampedPose& pose : estimated.poses)
      pose.T_table_camera =
          CameraPose(Eigen::Quaterniond(bad, 0.0, 0.0, 0.0), Eigen::Vector3d::Zero());
    EXPECT_EQ(hint_for(estimated, truth), "");
  }
}

TEST(PoseConventionHint, IsEmptyWithoutPairs) {
  std::mt19937 random(5);
  const Trajectory truth = random_trajectory(random);
  EXPECT_EQ(hint_for({}, truth), "");
}

}  // namespace
}  // namespace penumbra
