#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>
#include <penumbra/evaluation.hpp>
#include <tuple>

#include "recorded_frames.hpp"
#include "support/run_program.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;

evaluation::Trajectory truth_of_tabletop() {
  return evaluation::load_trajectory(recordings_dir() / "tabletop" / "groundtruth.tum");
}

// Returns the true poses, each moved by up to a millimetre.
evaluation::Trajectory estimate_of_tabletop() {
  evaluation::Trajectory poses = truth_of_tabletop();
  for (std::size_t i = 0; i < poses.size(); ++i) {
    poses[i].T_table_camera.position[i % 3] += 1e-4 * static_cast<double>(i % 11);
  }
  return poses;
}

TEST(LibraryEvaluation, ReadsFrameLogWithPredictedErrors) {
  const TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "log.csv";
  std::ofstream(file) << "timestamp_s,group,state,tx,ty,tz,qx,qy,qz,qw,predicted_px\n"
                         "0.5,table,tracked,0,0,1,1,0,0,0,0.25\n"
                         "0.6,table,lost,,,,,,,,\n";
  const evaluation::Trajectory poses = evaluation::load_trajectory(file);
  ASSERT_EQ(poses.size(), 1U);
  EXPECT_EQ(poses[0].timestamp_ns, 500'000'000);
  EXPECT_EQ(poses[0].predicted_px, 0.25);
  const std::filesystem::path lines = folder.path() / "log.jsonl";
  std::ofstream(lines) << "{\"timestamp_s\": 0.5, \"state\": \"tracked\"}\n";
  EXPECT_THAT(message_of([&] { std::ignore = evaluation::load_trajectory(lines); }),
              HasSubstr("is JSON"));
}

TEST(LibraryEvaluation, EqualsEvaluateCommand) {
  const TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "estimated.tum";
  evaluation::save_trajectory(file, estimate_of_tabletop());
  const std::filesystem::path recording = recordings_dir() / "tabletop";
  const ProgramResult command =
      run_program(program(), {"evaluate", "--estimated", file.string(), "--groundtruth",
                              (recording / "groundtruth.tum").string(), "--camera",
                              (recording / "camera.yaml").string(), "--json"});
  ASSERT_EQ(command.exit_code, 0) << command.err;
  const auto json = nlohmann::json::parse(command.out);

  const evaluation::Errors errors = evaluation::evaluate(
      camera_of("tabletop"), evaluation::load_trajectory(file), truth_of_tabletop());
  EXPECT_EQ(errors.frames_judged, json["frames_judged"].get<int>());
  EXPECT_EQ(errors.frames_estimated, json["frames_estimated"].get<int>());
  const auto expect_equal = [&](const char* key, const evaluation::Statistics& found) {
    EXPECT_NEAR(found.rmse, json[key]["rmse"].get<double>(), 1e-9 * found.rmse) << key;
    EXPECT_NEAR(found.median, json[key]["median"].get<double>(), 1e-9 * found.max) << key;
    EXPECT_NEAR(found.p95, json[key]["p95"].get<double>(), 1e-9 * found.max) << key;
    EXPECT_NEAR(found.max, json[key]["max"].get<double>(), 1e-9 * found.max) << key;
  };
  expect_equal("translation_mm", errors.translation_mm);
  expect_equal("overlay_px", errors.overlay_px);
  ASSERT_TRUE(errors.jitter_px);
  EXPECT_NEAR(*errors.jitter_px, json["jitter_px"].get<double>(), 1e-9 * *errors.jitter_px);
  EXPECT_NEAR(errors.translation_mm.max, 1.0, 1e-9);
}

TEST(LibraryEvaluation, RejectsInvalidTrajectoriesAndOptions) {
  const auto camera = camera_of("tabletop");
  const evaluation::Trajectory truth = truth_of_tabletop();
  const auto message = [&](const evaluation::Trajectory& estimated,
                           const evaluation::Options& options = {}) {
    return message_of(
        [&] { std::ignore = evaluation::evaluate(camera, estimated, truth, options); });
  };
  EXPECT_EQ(message(truth), "");
  EXPECT_THAT(message({}), HasSubstr("estimated: holds no pose"));
  for (const double bad : {kNan, kInfinity, -kInfinity}) {
    evaluation::Trajectory poses = truth;
    poses[3].T_table_camera.position[1] = bad;
    EXPECT_THAT(message(poses), HasSubstr("estimated[3]: T_table_camera: position"));
    poses = truth;
    poses[4].T_table_camera.quaternion_xyzw[0] = bad;
    EXPECT_THAT(message(poses), HasSubstr("estimated[4]: T_table_camera: quaternion"));
    poses = truth;
    poses[5].predicted_px = bad;
    EXPECT_THAT(message(poses), HasSubstr("predicted_px"));
    EXPECT_THAT(message(truth, {.max_gap_s = bad}), HasSubstr("max_gap_s"));
    EXPECT_THAT(message(truth, {.time_offset_s = bad}), HasSubstr("time_offset_s"));
  }
  evaluation::Trajectory poses = truth;
  poses[2].timestamp_ns = poses[1].timestamp_ns;
  EXPECT_THAT(message(poses), HasSubstr("is not after"));
  poses = truth;
  poses.back().timestamp_ns = std::numeric_limits<std::int64_t>::max();
  EXPECT_THAT(message(poses), HasSubstr("range"));
  EXPECT_THAT(message(truth, {.time_offset_s = 1e6}), HasSubstr("no pose that can be compared"));
}

TEST(LibraryEvaluation, TrajectoryFilesKeepEveryBit) {
  const TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "poses.tum";
  const evaluation::Trajectory poses = truth_of_tabletop();
  evaluation::save_trajectory(file, poses);
  std::ifstream in(file);
  std::string line;
  std::getline(in, line);
  for (const evaluation::StampedPose& pose : poses) {
    ASSERT_TRUE(std::getline(in, line));
    std::istringstream words(line);
    std::string word;
    words >> word;
    for (const double expected : pose.T_table_camera.position) {
      words >> word;
      EXPECT_EQ(std::strtod(word.c_str(), nullptr), expected);
    }
    for (const double expected : pose.T_table_camera.quaternion_xyzw) {
      words >> word;
      EXPECT_EQ(std::strtod(word.c_str(), nullptr), expected);
    }
  }
  EXPECT_THAT(
      message_of([&] { std::ignore = evaluation::load_trajectory(folder.path() / "none.tum"); }),
      HasSubstr("none.tum"));
}

}  // namespace
}  // namespace penumbra::test
