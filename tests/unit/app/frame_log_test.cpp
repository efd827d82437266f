#include "app/output/frame_log.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/geometry/trajectory.hpp"
#include "support/file_lines.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::json;

// A tracked frame with a group beside the table.
SessionFrame tracked_frame() {
  SessionFrame frame;
  frame.tracked.frame.sequence = 7;
  frame.tracked.frame.timestamp_ns = 1'700'000'000'123'456'789;
  frame.tracked.frame.utc_ns = 1'790'000'000'000'000'001;
  PoseEstimate& pose = frame.tracked.pose;
  pose.status = TrackStatus::tracked;
  pose.T_table_camera = {Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0), Eigen::Vector3d(0.5, -0.25, 1.0)};
  pose.predicted_overlay_error_px = 0.125;
  pose.reprojection_rms_px = 0.0625;
  pose.tags_used = 9;
  pose.tags_rejected = {{4, {}}, {11, {}}};
  for (int i = 0; i < 6; ++i) {
    for (int k = 0; k < 6; ++k)
      pose.covariance(i, k) = 10 * (std::min(i, k) + 1) + std::max(i, k) + 1;
  }
  frame.tracked.times.total_ms = 1.5;
  frame.draw_time.wall_ms = 4.5;
  GroupEstimate& group = frame.tracked.groups.emplace_back();
  group.name = "wall, \"left\"";
  group.status = TrackStatus::lost;
  return frame;
}

class FrameLogTest : public testing::Test {
 protected:
  // Writes frames and returns the lines of the file.
  std::vector<std::string> lines_of(const char* name, const std::vector<SessionFrame>& frames) {
    const auto file = folder_.path() / name;
    auto log = FrameLog::create(file);
    EXPECT_TRUE(log) << log.error().message;
    for (const SessionFrame& frame : frames) EXPECT_TRUE(log->write(frame));
    EXPECT_TRUE(log->finish());
    return test::complete_lines(file);
  }
  test::TemporaryFolder folder_;
};

TEST_F(FrameLogTest, WritesOneCsvRowPerFrameAndGroup) {
  const auto lines = lines_of("log.csv", {tracked_frame()});
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_EQ(lines[0],
            "frame,timestamp_s,wall_time,group,state,reason,tx,ty,tz,qx,qy,qz,qw,predicted_px,"
            "reprojection_px,tags_used,tags_rejected,age_s,cov_11,cov_12,cov_13,cov_14,cov_15,"
            "cov_16,cov_22,cov_23,cov_24,cov_25,cov_26,cov_33,cov_34,cov_35,cov_36,cov_44,cov_45,"
            "cov_46,cov_55,cov_56,cov_66,track_ms,detect_ms,align_ms,solve_ms,plan_ms,shadow_ms,"
            "render_ms,draw_ms");
  EXPECT_EQ(lines[1],
            "7,1700000000.123456789,2026-09-21T14:13:20.000000001Z,table,tracked,,0.5,-0.25,1.0,"
            "1.0,0.0,0.0,0.0,0.125,0.0625,9,4 "
            "11,0.0,11.0,12.0,13.0,14.0,15.0,16.0,22.0,23.0,24.0,25.0,26.0,33.0,34.0,35.0,36.0,"
            "44.0,45.0,46.0,55.0,56.0,66.0,1.5,0.0,0.0,0.0,0.0,0.0,0.0,4.5");
  EXPECT_EQ(lines[2],
            "7,1700000000.123456789,2026-09-21T14:13:20.000000001Z,\"wall, \"\"left\"\"\",lost" +
                std::string(11, ',') + "0" + std::string(31, ','));
}

TEST_F(FrameLogTest, WritesJsonLines) {
  const auto lines = lines_of("log.jsonl", {tracked_frame(), tracked_frame()});
  ASSERT_EQ(lines.size(), 4U);
  const Json table = Json::parse(lines[0]);
  EXPECT_EQ(table["frame"], 7);
  EXPECT_EQ(table["wall_time"], "2026-09-21T14:13:20.000000001Z");
  EXPECT_EQ(table["group"], "table");
  EXPECT_EQ(table["tags_rejected"], Json({4, 11}));
  EXPECT_EQ(table["cov_46"], 46.0);
  EXPECT_EQ(table["qx"], 1.0);
  const Json group = Json::parse(lines[1]);
  EXPECT_EQ(group["group"], "wall, \"left\"");
  EXPECT_TRUE(group["tx"].is_null());
  EXPECT_TRUE(group["track_ms"].is_null());
}

TEST_F(FrameLogTest, LeavesUnknownWallClockTimeEmpty) {
  SessionFrame frame = tracked_frame();
  frame.tracked.frame.utc_ns = std::nullopt;
  EXPECT_THAT(lines_of("log.csv", {frame})[1],
              testing::StartsWith("7,1700000000.123456789,,table"));
  EXPECT_TRUE(Json::parse(lines_of("log.jsonl", {frame})[0])["wall_time"].is_null());
}

// The tracked poses of the camera can be read as a trajectory.
TEST_F(FrameLogTest, IsReadAsTrajectory) {
  SessionFrame uncertain = tracked_frame();
  uncertain.tracked.frame.timestamp_ns += 40'000'000;
  uncertain.tracked.pose.status = TrackStatus::uncertain;
  SessionFrame unpredicted = tracked_frame();
  unpredicted.tracked.frame.timestamp_ns += 80'000'000;
  unpredicted.tracked.pose.predicted_overlay_error_px = std::numeric_limits<double>::infinity();
  unpredicted.tracked.groups[0].status = TrackStatus::tracked;
  (void)lines_of("log.csv", {tracked_frame(), uncertain, unpredicted});
  const auto read = load_trajectory(folder_.path() / "log.csv");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_FALSE(read->of_body);
  ASSERT_EQ(read->poses.size(), 2U);
  EXPECT_EQ(read->poses[0].timestamp_ns, 1'700'000'000'123'456'789);
  EXPECT_EQ(read->poses[0].T_table_camera.translation(), Eigen::Vector3d(0.5, -0.25, 1.0));
  EXPECT_EQ(read->poses[0].T_table_camera.rotation().x(), 1.0);
  EXPECT_EQ(read->poses[0].predicted_px, 0.125);
  EXPECT_EQ(read->poses[1].timestamp_ns, 1'700'000'000'203'456'789);
  EXPECT_EQ(read->poses[1].predicted_px, std::nullopt);
}

TEST_F(FrameLogTest, LeavesNonFiniteNumbersEmpty) {
  SessionFrame frame = tracked_frame();
  frame.tracked.groups.clear();
  frame.tracked.pose.predicted_overlay_error_px = std::numeric_limits<double>::infinity();
  frame.tracked.pose.covariance.setConstant(std::numeric_limits<double>::quiet_NaN());
  const auto csv = lines_of("log.csv", {frame});
  for (const char* word : {"nan", "inf"})
    EXPECT_THAT(csv[1], testing::Not(testing::HasSubstr(word)));
  const Json json = Json::parse(lines_of("log.jsonl", {frame})[0]);
  EXPECT_TRUE(json["predicted_px"].is_null());
  EXPECT_TRUE(json["cov_11"].is_null());
}

}  // namespace
}  // namespace penumbra
