#include "app/output/error_log.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/text/text.hpp"
#include "support/file_lines.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::json;

class ErrorLog : public testing::Test {
 protected:
  test::TemporaryFolder folder_;
};

PoseErrors judged(std::int64_t timestamp_ns) {
  PoseErrors errors;
  errors.timestamp_ns = timestamp_ns;
  errors.translation_mm = 1.5;
  errors.rotation_deg = 0.25;
  errors.overlay_px = 0.5;
  return errors;
}

TEST_F(ErrorLog, WritesPosesOfTableAndGroupsInOrderOfTime) {
  Evaluation table;
  table.poses = {judged(1'000'000'000), judged(1'040'000'000), judged(-5)};
  table.poses[0].jitter_px = 0.125;
  table.poses[0].predicted_px = 0.25;
  table.poses[0].ratio = 2.0;
  table.poses[1] = {};
  table.poses[1].timestamp_ns = 1'040'000'000;
  table.poses[1].not_judged = NotEvaluated::gap_too_long;
  Evaluation wall;
  wall.poses = {judged(1'040'000'000)};
  Evaluation prop;
  prop.poses = {judged(1'000'000'000), judged(1'040'000'000)};
  const auto file = folder_.path() / "errors.csv";
  ASSERT_TRUE(write_pose_errors(file, table, {{"wall", wall}, {"a, b", prop}}));
  EXPECT_EQ(
      test::complete_lines(file),
      (std::vector<std::string>{
          "timestamp_s,group,not_judged,translation_mm,rotation_deg,overlay_frame_px,"
          "jitter_px,predicted_px,frame_ratio",
          "1.000000000,table,,1.5,0.25,0.5,0.125,0.25,2.0", "1.000000000,\"a, b\",,1.5,0.25,0.5,,,",
          "1.040000000,table,gap_too_long,,,,,,", "1.040000000,\"a, b\",,1.5,0.25,0.5,,,",
          "1.040000000,wall,,1.5,0.25,0.5,,,", "-0.000000005,table,,1.5,0.25,0.5,,,"}));
  const auto json = folder_.path() / "errors.jsonl";
  ASSERT_TRUE(write_pose_errors(json, table, {}));
  const auto lines = test::complete_lines(json);
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_EQ(Json::parse(lines[1])["not_judged"], "gap_too_long");
  EXPECT_TRUE(Json::parse(lines[1])["translation_mm"].is_null());
  EXPECT_TRUE(Json::parse(lines[0])["not_judged"].is_null());
  EXPECT_EQ(Json::parse(lines[0])["frame_ratio"], 2.0);
}

TEST_F(ErrorLog, WritesDifferencesOfHalves) {
  const auto file = folder_.path() / "halves.csv";
  auto log = HalfErrorLog::create(file);
  ASSERT_TRUE(log) << log.error().message;
  Frame frame;
  frame.sequence = 7;
  frame.timestamp_ns = 2'000'000'001;
  HalfDifference difference;
  difference.difference_px = 0.5;
  difference.predicted_px = 0.25;
  ASSERT_TRUE(log->add(frame, 0, difference));
  frame.utc_ns = 0;
  difference.predicted_px = 0.0;
  ASSERT_TRUE(log->add(frame, 1, difference));
  difference.rejection = HalfRejection::out_of_view;
  difference.difference_px = std::numeric_limits<double>::infinity();
  ASSERT_TRUE(log->add(frame, 3, difference));
  ASSERT_TRUE(log->finish());
  EXPECT_EQ(test::complete_lines(file),
            (std::vector<std::string>{
                "frame,timestamp_s,wall_time,split,rejected,split_half_px,predicted_px,frame_ratio",
                "7,2.000000001,,1,,0.5,0.25,2.0",
                "7,2.000000001,1970-01-01T00:00:00.000000000Z,2,,0.5,0.0,",
                "7,2.000000001,1970-01-01T00:00:00.000000000Z,4,out_of_view,,,"}));
}

// After an error, rows are kept; a log without rows does not replace an existing file.
TEST_F(ErrorLog, KeepsRowsButNotAnEmptyLogAfterError) {
  const auto file = folder_.path() / "halves.csv";
  ASSERT_TRUE(write_text_file(file, "old\n"));
  {
    auto log = HalfErrorLog::create(file);
    ASSERT_TRUE(log);
    log->rescue();
  }
  EXPECT_EQ(test::complete_lines(file), std::vector<std::string>{"old"});
  {
    auto log = HalfErrorLog::create(file);
    ASSERT_TRUE(log);
    ASSERT_TRUE(log->add(Frame(), 0, HalfDifference()));
    log->rescue();
  }
  EXPECT_EQ(test::complete_lines(file).size(), 2U);
}

TEST_F(ErrorLog, FailsInFolderThatIsMissing) {
  EXPECT_FALSE(write_pose_errors(folder_.path() / "no" / "errors.csv", Evaluation(), {}));
  EXPECT_FALSE(HalfErrorLog::create(folder_.path() / "no" / "errors.csv"));
}

}  // namespace
}  // namespace penumbra
