// penumbra live, with a recording that plays as a camera.
#include <gtest/gtest.h>

#include <csignal>
#include <filesystem>
#include <thread>

#include "core/camera_file.hpp"
#include "core/evaluation.hpp"
#include "core/trajectory.hpp"
#include "replay/replay_support.hpp"

namespace penumbra {
namespace {

using test::bundled;
using test::penumbra;

std::string calibration() {
  return bundled("tabletop") + "/camera.yaml";
}

std::vector<std::string> live(const std::vector<std::string>& more) {
  std::vector<std::string> arguments = {
      "live",          "--camera",    "recording:" + bundled("tabletop"),
      "--calibration", calibration(), "--no-window"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

TEST(Live, TracksDrawsAndRecordsAndTheRecordingReplaysToTheSamePoses) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  const auto done = penumbra(live({"--duration", "3", "--record", path("session"), "--poses",
                                   path("live.tum"), "--report", path("report.json")}));
  ASSERT_EQ(done.exit_code, 0) << done.err;
  const auto report = test::read_json(path("report.json"));
  const int frames = report["frames"];
  EXPECT_GT(frames, 0);
  EXPECT_EQ(report["frames_captured"].get<int>(), frames + report["frames_dropped"].get<int>());
  EXPECT_GE(report["frames_tracked"].get<int>(), frames * 95 / 100);
  EXPECT_EQ(report["time_ms"]["latency"]["count"], frames);
  EXPECT_GT(report["time_ms"]["latency"]["median"].get<double>(), 0.0);

  // The camera's own bytes.
  const auto recorded = test::contents_of(temporary.path() / "session" / "frames");
  const auto played = test::contents_of(test::recordings_dir() / "tabletop" / "frames");
  ASSERT_FALSE(recorded.empty());
  EXPECT_EQ(recorded.begin()->second, played.begin()->second);

  const auto replayed =
      penumbra({"replay", path("session"), "--no-window", "--poses", path("replay.tum")});
  ASSERT_EQ(replayed.exit_code, 0) << replayed.err;
  const auto a = load_trajectory(path("live.tum"));
  const auto b = load_trajectory(path("replay.tum"));
  const auto camera = load_camera(calibration());
  ASSERT_TRUE(a && b && camera);
  Trajectory both;
  for (const StampedPose& pose : a->poses) {
    if (const StampedPose* same = b->at(pose.timestamp_ns)) both.poses.push_back(*same);
  }
  ASSERT_GT(both.poses.size(), 0U);
  const Evaluation difference = evaluate(*camera, *a, both);
  EXPECT_LT(difference.overlay_px.max, 0.2);
}

TEST(Live, CtrlCEndsCleanlyAndLeavesReadableFiles) {
  const test::TemporaryFolder temporary;
  const auto session = temporary.path() / "session";
  std::thread interrupter;
  const auto done = test::run_program(
      test::program(), live({"--record", session.string()}), {}, {}, [&](pid_t child) {
        interrupter = std::thread([&session, child] {
          // Once frames are being recorded.
          while (test::lines_of(test::bytes_of(session / "timestamps.csv")).size() < 20) {
            std::this_thread::sleep_for(std::chrono::milliseconds(10));
          }
          kill(child, SIGINT);
        });
      });
  interrupter.join();
  EXPECT_EQ(done.exit_code, 0) << done.err;
  EXPECT_EQ(done.err, "");
  const std::string last = test::lines_of(test::bytes_of(session / "events.jsonl")).back();
  EXPECT_NE(last.find("\"end\""), std::string::npos) << last;
  const auto replayed = penumbra({"replay", session.string(), "--no-window"});
  EXPECT_EQ(replayed.exit_code, 0) << replayed.err;
  EXPECT_EQ(replayed.err, "");
}

TEST(Live, ARecordingThatCouldNotBeWrittenIsAFailureAndThePictureGoesOn) {
  const test::TemporaryFolder temporary;
  const std::string session = (temporary.path() / "session").string();
  // No file may grow beyond 8 KiB, less than a frame has.
  std::vector<std::string> words = {"-c", R"(trap '' XFSZ; ulimit -f 8; exec "$0" "$@")",
                                    test::program().string()};
  for (const std::string& word : live({"--duration", "1", "--record", session})) {
    words.push_back(word);
  }
  const auto done = test::run_program("/bin/bash", words);
  EXPECT_EQ(done.exit_code, 1);
  EXPECT_NE(done.err.find("the recording ends here, the picture goes on"), std::string::npos)
      << done.err;
  const std::string last = test::lines_of(done.err).back();
  EXPECT_NE(last.find(session), std::string::npos) << done.err;
  EXPECT_NE(last.find("free some space"), std::string::npos) << done.err;
}

TEST(Live, SaysWhatIsMissingInOneLine) {
  test::expect_failure(penumbra({"live", "--no-window"}), {"--calibration", "penumbra calibrate"});
  test::expect_failure(penumbra({"live", "--no-window", "--camera", "v4l2:/dev/no-such-camera",
                                 "--calibration", calibration()}),
                       {"/dev/no-such-camera", "no such camera", "penumbra devices"});
  test::expect_failure(penumbra({"live", "--no-window", "--camera", "v4l2:/dev/null",
                                 "--calibration", calibration()}),
                       {"/dev/null", "no camera"});
  test::expect_failure(
      penumbra({"live", "--no-window", "--camera", "telescope", "--calibration", calibration()}),
      {"telescope", "v4l2:/dev/video0"});
  test::expect_failure(penumbra({"live", "--no-window", "--camera", "libcamera:no-such-camera",
                                 "--calibration", calibration()}),
                       {"libcamera"});
  const test::TemporaryFolder full;
  std::filesystem::create_directory(full.path() / "old");
  test::expect_failure(penumbra(live({"--record", full.path().string()})), {"not empty"});
}

TEST(Live, WrongUsageIsExitCode2) {
  EXPECT_EQ(penumbra(live({"--size", "640"})).exit_code, 2);
  EXPECT_EQ(penumbra(live({"--format", "bayer"})).exit_code, 2);
  // What a recording can't obey.
  for (const std::vector<std::string>& option : std::vector<std::vector<std::string>>{
           {"--size", "640x480"}, {"--format", "grey"}, {"--exposure", "4"}, {"--focus", "1"}}) {
    const auto done = penumbra(live(option));
    EXPECT_EQ(done.exit_code, 2) << option[0];
    EXPECT_NE(done.err.find(option[0]), std::string::npos) << done.err;
  }
  EXPECT_EQ(penumbra(live({"--exposure", "long"})).exit_code, 2);
  EXPECT_EQ(penumbra(live({"--duration", "-1"})).exit_code, 2);
}

TEST(Devices, ListsWhatThereIs) {
  const auto done = penumbra({"devices"});
  EXPECT_EQ(done.exit_code, 0) << done.err;
  EXPECT_NE(done.out.find("libcamera"), std::string::npos) << done.out;
}

}  // namespace
}  // namespace penumbra
