#include "core/geometry/trajectory.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "core/evaluation/pairing.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

class TrajectoryFile : public testing::Test {
 protected:
  Result<Trajectory> load(std::string_view text) {
    EXPECT_TRUE(write_text_file(file_, text));
    return load_trajectory(file_);
  }
  void refuses(std::string_view text, const char* what) {
    const Result<Trajectory> read = load(text);
    ASSERT_FALSE(read) << text;
    EXPECT_THAT(read.error().message,
                testing::AllOf(testing::HasSubstr("path.tum"), testing::HasSubstr(what)));
  }
  test::TemporaryFolder folder_;
  std::filesystem::path file_ = folder_.path() / "path.tum";
};

TEST_F(TrajectoryFile, ReadsPosesAndComments) {
  const auto read = load(
      "# a comment\n\n1.5 1 2 3 0 0 0 1\r\n"
      "  2.25\t-1 0.5 3e-1 0 0 0.6 0.8 # held 0.1 s\n"
      "3 0 0 0 1 0 0 0");
  ASSERT_TRUE(read) << read.error().message;
  ASSERT_EQ(read->poses.size(), 3U);
  EXPECT_EQ(read->poses[0].timestamp_ns, 1500000000);
  EXPECT_EQ(read->poses[0].T_table_camera.translation(), Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(read->poses[1].comment, "held 0.1 s");
  EXPECT_NEAR(read->poses[1].T_table_camera.rotation().z(), 0.6, 1e-15);
  EXPECT_EQ(read->poses[2].T_table_camera.rotation().x(), 1.0);
}

TEST_F(TrajectoryFile, ReportsFileAndLineOfError) {
  refuses("0 0 0 0 0 0 0\n", "line 1");
  refuses("0 0 0 0 0 0 0 1\n# x\n1 0 0 0 0 0 0 1 5\n", "line 3");
  refuses("0 nan 0 0 0 0 0 1\n", "tx");
  refuses("0 0 inf 0 0 0 0 1\n", "ty");
  refuses("0 0 0 0 0 0 0 0x1\n", "qw");
  refuses("0 0 0 0 0 0 0 0\n", "quaternion");
  refuses("0 0 0 0 0 0 0 1.01\n", "quaternion");
  refuses("when 0 0 0 0 0 0 1\n", "timestamp");
  refuses("1 0 0 0 0 0 0 1\n0.5 0 0 0 0 0 0 1\n", "line 2");
  refuses("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n2.0000000001 0 0 0 0 0 0 1\n", "line 3");
  refuses("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "timestamps must increase");
  EXPECT_FALSE(load_trajectory(folder_.path() / "absent.tum"));
}

TEST_F(TrajectoryFile, ReportsUnitOfTimestampsTooLargeForSeconds) {
  refuses("1604644894000 0 0 0 0 0 0 1\n", "milliseconds; divide by 1e3");
  refuses("1604644894000000 0 0 0 0 0 0 1\n", "microseconds; divide by 1e6");
  refuses("1403636579763555584 0 0 0 0 0 0 1\n", "nanoseconds; divide by 1e9");
  refuses("1e300 0 0 0 0 0 0 1\n", "line 1: timestamp");
  refuses("inf 0 0 0 0 0 0 1\n", "line 1: timestamp");
}

TEST_F(TrajectoryFile, SkipsByteOrderMarkAndReportsUtf16) {
  const auto read = load("\xEF\xBB\xBF# timestamp tx ty tz qx qy qz qw\r\n1 2 3 4 0 0 0 1\r\n");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->poses.at(0).T_table_camera.translation(), Eigen::Vector3d(2, 3, 4));
  refuses(std::string_view("\xFF\xFE#\0 \0\n\0", 8), "UTF-16");
}

TEST_F(TrajectoryFile, ReadsEurocGroundtruth) {
  const char* header =
      "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], "
      "q_RS_z [], v_RS_R_x [m s^-1]\n";
  const std::string rows =
      "1403636580838555648,4.5,-1.8,0.75,0.6,0.8,0,0,0.1\r\n"
      "1.403636580843555648e+18, 4.6, -1.7, 0.76, 0.8, 0, 0.6, 0,\n";
  for (const std::string& text : {header + rows, rows}) {
    const auto read = load(text);
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_TRUE(read->of_body);
    ASSERT_EQ(read->poses.size(), 2U);
    EXPECT_EQ(read->poses[0].timestamp_ns, 1403636580838555648);
    EXPECT_EQ(read->poses[1].timestamp_ns, 1403636580843555648);
    EXPECT_EQ(read->poses[0].T_table_camera.translation(), Eigen::Vector3d(4.5, -1.8, 0.75));
    EXPECT_NEAR(read->poses[0].T_table_camera.rotation().w(), 0.6, 1e-15);
    EXPECT_NEAR(read->poses[0].T_table_camera.rotation().x(), 0.8, 1e-15);
    EXPECT_NEAR(read->poses[1].T_table_camera.rotation().y(), 0.6, 1e-15);
  }
  // The header determines whether w comes first or last.
  const auto w_last = load("timestamp [ns],px,py,pz,qx,qy,qz,qw\n5,1,2,3,0.8,0,0,0.6\n");
  ASSERT_TRUE(w_last) << w_last.error().message;
  EXPECT_NEAR(w_last->poses.at(0).T_table_camera.rotation().w(), 0.6, 1e-15);
  EXPECT_FALSE(load("1 2 3 4 0 0 0 1\n")->of_body);
}

TEST_F(TrajectoryFile, RejectsAndReportsOtherCsvFiles) {
  refuses("1403636580838555648,4.5,-1.8,0.75\n", "has 4 values between commas");
  refuses("1.25,4.5,-1.8,0.75,1,0,0,0\n", "not a whole number of nanoseconds");
  refuses("1,4.5,-1.8,0.75,0.6,0.6,0,0\n", "not a rotation");
  refuses("1,4.5,nan,0.75,1,0,0,0\n", "ty");
  refuses("5,0,0,1,1,0,0,0\n5,0,0,1,1,0,0,0\n", "timestamps must increase");
  refuses("1e99999999999,0,0,1,1,0,0,0\n", "nanoseconds");
}

TEST_F(TrajectoryFile, ReadsTrackedPosesOfFrameLog) {
  const std::string header =
      "frame,timestamp_s,group,state,reason,tx,ty,tz,qx,qy,qz,qw,predicted_px\n";
  const auto read = load(header +
                         "0,1.5,table,tracked,,1,2,3,0,0,0,1,0.25\r\n"
                         "0,1.5,\"#1, \"\"a\"\"\",tracked,,9,9,9,0,0,0,1,0.5\n"
                         "1,1.6,table,uncertain,\"two poses, both fit\",1,2,4,0,0,0,1,7\n"
                         "2,1.7,table,lost,,,,,,,,,\n\n"
                         "3,1.8,table,tracked,\"# a, b\",1,2,5,0,0,0.6,0.8,");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_FALSE(read->of_body);
  ASSERT_EQ(read->poses.size(), 2U);
  EXPECT_EQ(read->poses[0].timestamp_ns, 1'500'000'000);
  EXPECT_EQ(read->poses[0].predicted_px, 0.25);
  EXPECT_EQ(read->poses[1].timestamp_ns, 1'800'000'000);
  EXPECT_EQ(read->poses[1].T_table_camera.translation(), Eigen::Vector3d(1, 2, 5));
  EXPECT_EQ(read->poses[1].predicted_px, std::nullopt);
  EXPECT_EQ(read->untracked, 2);

  refuses("timestamp_s,group,state,tx,ty,tz,qx,qy,qz,predicted_px\n", "line 1: has no column qw");
  refuses(header + "0,1.5,table,tracked,,1,2,3,0,0,0,1\n", "line 2: has 12 values between commas");
  refuses(header + "0,1.5,table,tracked,,1,2,,0,0,0,1,0\n", "line 2: tz");
  refuses(header + "0,x,table,tracked,,1,2,3,0,0,0,1,0\n", "line 2: timestamp: 'x'");
  refuses(header + "0,1,table,tracked,,1,2,3,0,0,0,1,-1\n", "line 2: predicted_px: '-1'");
  refuses(header + "0,1,table,tracked,,1,2,3,0,0,0,1,inf\n", "line 2: predicted_px: 'inf'");
  refuses(header + "0,2,table,tracked,,1,2,3,0,0,0,1,0\n1,2,table,tracked,,1,2,3,0,0,0,1,0\n",
          "line 3: timestamp: 2.000000000 s is that of the pose above");
}

TEST(TrajectoryCases, ReadTumAndEurocAndRejectUtf16AndMilliseconds) {
  const std::filesystem::path shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const std::filesystem::path folder = shared / "cases" / "tum-byte-order-mark";
  const auto marked = load_trajectory(folder / "bom.tum");
  ASSERT_TRUE(marked) << marked.error().message;
  const auto wide = load_trajectory(folder / "utf16.tum");
  ASSERT_FALSE(wide);
  EXPECT_THAT(wide.error().message, testing::HasSubstr("UTF-16"));
  const auto euroc = load_trajectory(folder / "euroc.csv");
  ASSERT_TRUE(euroc) << euroc.error().message;
  // The same path in both formats.
  ASSERT_LE(euroc->poses.size(), marked->poses.size());
  for (std::size_t i = 0; i < euroc->poses.size(); ++i) {
    const StampedPose& a = euroc->poses[i];
    const StampedPose& b = marked->poses[i];
    EXPECT_EQ(a.timestamp_ns, b.timestamp_ns);
    EXPECT_EQ(a.T_table_camera.translation(), b.T_table_camera.translation());
    EXPECT_LT(a.T_table_camera.rotation().angularDistance(b.T_table_camera.rotation()), 1e-12);
  }
  const std::filesystem::path times = shared / "cases" / "evaluate-times";
  EXPECT_FALSE(load_trajectory(times / "allsame.tum"));
  const auto truth = load_trajectory(shared / "recordings" / "tabletop" / "groundtruth.tum");
  const auto milliseconds = load_trajectory(times / "ms.tum");
  ASSERT_TRUE(truth && milliseconds);
  const auto checked = check_units_of_time({*milliseconds, "ms.tum"}, {*truth, "truth"}, {});
  ASSERT_FALSE(checked);
  EXPECT_THAT(checked.error().message, testing::HasSubstr("milliseconds"));
}

TEST_F(TrajectoryFile, RoundTripsExactly) {
  Trajectory trajectory;
  for (int i = 0; i < 20; ++i) {
    StampedPose pose;
    pose.timestamp_ns = 1403636579763555527 + i * 33333333LL;
    pose.T_table_camera = CameraPose(Eigen::Quaterniond(0.3 + i, -0.2, 0.7, 0.1),
                                     Eigen::Vector3d(1.0 / 3.0, i, -1e-9));
    if (i % 2 == 1) pose.comment = "held\nfor a while";
    trajectory.poses.push_back(pose);
  }
  ASSERT_TRUE(save_trajectory(file_, trajectory));
  const auto read = load_trajectory(file_);
  ASSERT_TRUE(read) << read.error().message;
  ASSERT_EQ(read->poses.size(), 20U);
  for (std::size_t i = 0; i < 20; ++i) {
    EXPECT_EQ(read->poses[i].timestamp_ns, trajectory.poses[i].timestamp_ns);
    EXPECT_EQ(read->poses[i].T_table_camera.translation(),
              trajectory.poses[i].T_table_camera.translation());
    EXPECT_LT(read->poses[i].T_table_camera.rotation().angularDistance(
                  trajectory.poses[i].T_table_camera.rotation()),
              1e-15);
  }
  EXPECT_EQ(read->poses[1].comment, "held for a while");
  EXPECT_FALSE(save_trajectory(folder_.path() / "no" / "path.tum", trajectory));
}

// Pose of a camera that rotates and moves uniformly.
CameraPose pose_at_time(double t) {
  return {
      Eigen::Quaterniond(Eigen::AngleAxisd(0.9 * t, Eigen::Vector3d(1.0, 2.0, -1.0).normalized())),
      Eigen::Vector3d(0.3 * t, -0.2 * t, 1.0 + 0.1 * t)};
}

TEST(Trajectory, InterpolatesAndExtrapolatesUniformMotion) {
  Trajectory t;
  for (const double time : {0.0, 0.4, 0.5, 1.1, 1.2})
    t.poses.push_back({nanoseconds(time), pose_at_time(time), {}});
  for (const double time : {-0.3, 0.0, 0.1, 0.4, 0.47, 0.8, 1.13, 1.2, 1.5}) {
    const CameraPose pose = interpolate_pose(t, nanoseconds(time));
    EXPECT_LT((pose.translation() - pose_at_time(time).translation()).norm(), 1e-9) << time;
    EXPECT_LT(pose.rotation().angularDistance(pose_at_time(time).rotation()), 1e-8) << time;
  }
  Trajectory one;
  one.poses = {t.poses[1]};
  EXPECT_EQ(interpolate_pose(one, 5).translation(), t.poses[1].T_table_camera.translation());
}

TEST(Trajectory, InterpolatesSmoothlyAcrossPoses) {
  Trajectory t;
  for (int i = 0; i < 8; ++i) {
    const double a = 0.7 * i;
    t.poses.push_back(
        {nanoseconds(0.1 * i + 0.02 * (i % 3)),
         {Eigen::Quaterniond(Eigen::AngleAxisd(0.5 * std::sin(a), Eigen::Vector3d::UnitX()) *
                             Eigen::AngleAxisd(0.8 * std::cos(1.3 * a), Eigen::Vector3d::UnitY())),
          Eigen::Vector3d(std::sin(a), std::cos(a), 0.1 * a)},
         {}});
  }
  for (std::size_t i = 1; i + 1 < t.poses.size(); ++i) {
    const std::int64_t time = t.poses[i].timestamp_ns;
    const CameraPose& pose = t.poses[i].T_table_camera;
    EXPECT_LT((interpolate_pose(t, time).translation() - pose.translation()).norm(), 1e-12);
    EXPECT_LT(interpolate_pose(t, time).rotation().angularDistance(pose.rotation()), 1e-7);
    constexpr std::int64_t kStep = 10'000;
    const CameraPose before = interpolate_pose(t, time - kStep);
    const CameraPose after = interpolate_pose(t, time + kStep);
    const auto T_before = before.inverse() * pose;
    const auto T_after = pose.inverse() * after;
    EXPECT_LT((T_before.translation() - T_after.translation()).norm(),
              0.01 * T_after.translation().norm() + 1e-9);
    const Eigen::Vector3d turn_before = 2.0 * T_before.rotation().vec();
    const Eigen::Vector3d turn_after = 2.0 * T_after.rotation().vec();
    EXPECT_LT((turn_before - turn_after).norm(), 0.01 * turn_after.norm() + 1e-9);
  }
}

TEST(Trajectory, FindsNearestPose) {
  Trajectory t;
  for (const std::int64_t time : {0, 10, 20, 40}) t.poses.push_back({time, {}, {}});
  EXPECT_EQ(t.at(0, 0), &t.poses[0]);
  EXPECT_EQ(t.at(14, 5), &t.poses[1]);
  EXPECT_EQ(t.at(16, 5), &t.poses[2]);
  EXPECT_EQ(t.at(30, 5), nullptr);
  EXPECT_EQ(t.at(30, 10), &t.poses[2]) << "of two equally near poses, the earlier one";
  EXPECT_EQ(t.at(-3, 5), &t.poses[0]);
  EXPECT_EQ(t.at(99, 5), nullptr);
  EXPECT_EQ(Trajectory{}.at(0, 100), nullptr);
}

}  // namespace
}  // namespace penumbra
