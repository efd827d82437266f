// Replays of the bundled recordings with the built program.

#include <gmock/gmock.h>

#include <fmt/format.h>
#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <map>
#include <sstream>
#include <thread>

#include "replay_support.hpp"
#include "support/techniques.hpp"
#include "support/test_form.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

struct Replay {
  ProgramResult result;
  nlohmann::json report;
};

Replay replay(const fs::path& folder, std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), "replay");
  arguments.insert(arguments.end(), {"--report", folder / "report.json"});
  Replay replay;
  replay.result = penumbra(arguments);
  replay.report = read_json(folder / "report.json");
  return replay;
}

// Returns the number of poses in a TUM file.
int pose_count(const fs::path& file) {
  int count = 0;
  for (const std::string& line : lines_of(bytes_of(file))) count += line.starts_with("#") ? 0 : 1;
  return count;
}

TEST(ReplayCommand, TracksTabletopInEveryFrameWithinTwoPixels) {
  const TemporaryFolder folder;
  const Replay done =
      replay(folder.path(), {bundled("tabletop"), "--poses", folder.path() / "out.tum"});
  ASSERT_EQ(done.result.exit_code, 0) << done.result.err;
  EXPECT_EQ(done.result.err, "");
  EXPECT_THAT(done.result.out, HasSubstr("no display"));
  ASSERT_TRUE(done.report.is_object());
  EXPECT_EQ(done.report["frames"], 120);
  EXPECT_EQ(done.report["frames_captured"], 120);
  EXPECT_EQ(done.report["frames_dropped"], 0);
  EXPECT_EQ(done.report["frames_tracked"], 120);
  EXPECT_EQ(done.report["frames_lost"], 0);
  EXPECT_EQ(pose_count(folder.path() / "out.tum"), 120);
  const nlohmann::json& accuracy = done.report["accuracy"];
  EXPECT_EQ(accuracy["frames_with_truth"], 120);
  EXPECT_EQ(accuracy["frames_with_pose"], 120);
  EXPECT_LE(accuracy["overlay_px"]["median"].get<double>(), 0.5);
  EXPECT_LE(accuracy["overlay_px"]["max"].get<double>(), 2.0);
  EXPECT_GT(accuracy["overlay_px"]["max"].get<double>(), 0.0)
      << "the truth must not be the estimate";
  for (const char* stage : {"capture", "track", "align", "shadow", "render", "frame"}) {
    EXPECT_EQ(done.report["time_ms"][stage]["count"], 120) << stage;
  }
  // The first frame is detected, the others are aligned.
  EXPECT_EQ(done.report["time_ms"]["detect"]["count"], 1);
  EXPECT_EQ(done.report["tracking"]["full_detections"], 1);
  EXPECT_EQ(done.report["tracking"]["tracked_updates"], 119);
  for (const char* stage : {"capture", "track", "render", "frame"}) {
    EXPECT_GT(done.report["time_ms"][stage]["median"].get<double>(), 0.0) << stage;
  }
  EXPECT_GT(done.report["time_ms"]["capture"]["cpu_mean"].get<double>(), 0.0);
  EXPECT_GT(done.report["work"]["passes_drawn"].get<int>(), 120);

  // `evaluate` must report the same accuracy from the pose file.
  const ProgramResult evaluated =
      penumbra({"evaluate", "--estimated", folder.path() / "out.tum", "--groundtruth",
                bundled("tabletop") + "/groundtruth.tum", "--camera",
                bundled("tabletop") + "/camera.yaml", "--json"});
  ASSERT_EQ(evaluated.exit_code, 0) << evaluated.err;
  const nlohmann::json again = nlohmann::json::parse(evaluated.out, nullptr, false);
  EXPECT_NEAR(again["overlay_px"]["rmse"].get<double>(),
              accuracy["overlay_px"]["rmse"].get<double>(), 1e-9);
  EXPECT_NEAR(again["jitter_px"].get<double>(), accuracy["jitter_px"].get<double>(), 1e-9);
}

TEST(ReplayCommand, TracksCornerWithTagsInTwoPlanes) {
  const TemporaryFolder folder;
  const Replay done = replay(folder.path(), {bundled("corner")});
  ASSERT_EQ(done.result.exit_code, 0) << done.result.err;
  EXPECT_EQ(done.report["frames"], 40);
  EXPECT_EQ(done.report["frames_tracked"], 40);
  EXPECT_LE(done.report["accuracy"]["overlay_px"]["median"].get<double>(), 0.5);
  EXPECT_LE(done.report["accuracy"]["overlay_px"]["max"].get<double>(), 2.0);
}

class SharedRecordings : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(Replay, SharedRecordings,
                         testing::Values("shake", "grazing", "still", "single", "reentry"),
                         [](const auto& test) { return std::string(test.param); });

// The short form replays frames 20 to 49, where `reentry` loses the board and the other cameras
// move.
TEST_P(SharedRecordings, ReportStatusOfEveryFrame) {
  const fs::path shared = shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const TemporaryFolder folder;
  const fs::path recording = shared / "recordings" / GetParam();
  const auto whole = lines_of(bytes_of(recording / "timestamps.csv")).size() - 1;
  const std::size_t first = nightly() ? 0 : 20;
  const std::size_t end = nightly() ? whole : 50;
  const std::size_t listed = end - first;
  const Replay done = replay(
      folder.path(), {recording.string(), "--frames", fmt::format("{}:{}", first, end), "--output",
                      folder.path() / "out", "--poses", folder.path() / "out.tum"});
  ASSERT_EQ(done.result.exit_code, 0) << done.result.err;
  EXPECT_EQ(done.report["frames"].get<std::size_t>(), listed);
  EXPECT_EQ(contents_of(folder.path() / "out").size(), listed);
  int accounted = 0;
  for (const char* state : {"frames_tracked", "frames_uncertain", "frames_held", "frames_lost"}) {
    accounted += done.report[state].get<int>();
  }
  EXPECT_EQ(static_cast<std::size_t>(accounted), listed);
  EXPECT_EQ(pose_count(folder.path() / "out.tum"), done.report["frames_tracked"].get<int>());
}

TEST(ReplayCommand, WritesSameBytesWhenRunTwice) {
  const TemporaryFolder folder;
  const auto run = [&](const std::string& name, const std::vector<std::string>& more) {
    const fs::path base = folder.path() / name;
    std::vector<std::string> arguments = {
        "replay",   bundled("corner"), "--frames", "4:7",
        "--output", base.string(),     "--poses",  base.string() + ".tum"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const ProgramResult result = penumbra(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
  };
  run("a", {});
  run("b", {});
  run("one-thread", {"--threads", "1"});
  run("no-skip", {"--no-skip"});
  run("a.mkv", {});
  run("b.mkv", {});
  run("a.mp4", {});
  run("b.mp4", {});
  const auto frames = contents_of(folder.path() / "a");
  ASSERT_EQ(frames.size(), 3U);
  const std::string poses = bytes_of(folder.path() / "a.tum");
  EXPECT_EQ(pose_count(folder.path() / "a.tum"), 3);
  for (const char* other : {"b", "one-thread", "no-skip"}) {
    EXPECT_EQ(contents_of(folder.path() / other), frames) << other;
    EXPECT_EQ(bytes_of(folder.path() / (std::string(other) + ".tum")), poses) << other;
  }
  EXPECT_EQ(fingerprint_of(folder.path() / "a.mkv"), fingerprint_of(folder.path() / "b.mkv"));
  EXPECT_EQ(fingerprint_of(folder.path() / "a.mp4"), fingerprint_of(folder.path() / "b.mp4"));
  EXPECT_EQ(bytes_of(folder.path() / "a.mkv.tum"), poses);
}

// The camera turns away from the table, so that first objects and then their shadows leave the
// image.
TEST(ReplayCommand, DrawsSameFramesWithAndWithoutSkipping) {
  const TemporaryFolder folder;
  std::string poses;
  int frame = 0;
  for (const std::string& line :
       lines_of(bytes_of(recordings_dir() / "tabletop" / "groundtruth.tum"))) {
    if (line.empty() || line.starts_with("#")) continue;
    std::istringstream fields(line);
    std::string time;
    std::array<double, 7> v{};
    fields >> time;
    for (double& value : v) fields >> value;
    poses += fmt::format("{} {} {} {} {} {} {} {}\n", time, v[0] + 0.04 * frame++, v[1], v[2], v[3],
                         v[4], v[5], v[6]);
    if (frame == 20) break;
  }
  std::ofstream(folder.path() / "away.tum") << poses;
  std::map<std::string, nlohmann::json> reports;
  for (const std::string name : {"skip", "no-skip"}) {
    std::vector<std::string> arguments = {bundled("tabletop"),
                                          "--frames",
                                          "0:20",
                                          "--poses-from",
                                          folder.path() / "away.tum",
                                          "--output",
                                          folder.path() / name};
    if (name == "no-skip") arguments.emplace_back("--no-skip");
    const Replay done = replay(folder.path(), arguments);
    ASSERT_EQ(done.result.exit_code, 0) << done.result.err;
    reports[name] = done.report;
  }
  EXPECT_EQ(contents_of(folder.path() / "skip").size(), 20U);
  EXPECT_EQ(contents_of(folder.path() / "skip"), contents_of(folder.path() / "no-skip"));
  EXPECT_GT(reports["skip"]["work"]["passes_skipped"].get<int>(), 20);
  EXPECT_GT(reports["skip"]["skipped"].size(), 0U);
  EXPECT_EQ(reports["no-skip"]["work"]["passes_skipped"], 0);
}

TEST(ReplayCommand, WritesFilesNamedByFrameNumber) {
  const TemporaryFolder folder;
  const fs::path recording = folder.path() / "gaps";
  fs::copy(bundled("corner"), recording, fs::copy_options::recursive);
  std::string listing;
  for (const std::string& line : lines_of(bytes_of(recording / "timestamps.csv"))) {
    // Leaves out frames 3, 4 and 5, as if the camera had dropped them.
    if (!line.starts_with("3,") && !line.starts_with("4,") && !line.starts_with("5,")) {
      listing += line + "\n";
    }
  }
  std::ofstream(recording / "timestamps.csv") << listing;
  const Replay done =
      replay(folder.path(), {recording, "--frames", "2:8", "--output", folder.path() / "out"});
  ASSERT_EQ(done.result.exit_code, 0) << done.result.err;
  std::vector<std::string> names;
  for (const auto& [name, bytes] : contents_of(folder.path() / "out")) names.push_back(name);
  EXPECT_THAT(names, testing::ElementsAre("000002.png", "000006.png", "000007.png"));
  expect_failure(penumbra({"replay", recording, "--frames", "3:6"}), {"gaps", "3:6"});
}

TEST(ReplayCommand, AcceptsOutputNamesWithColonsAndDanglingLinks) {
  const TemporaryFolder folder;
  const fs::path video = folder.path() / "http:out.mkv";
  fs::create_symlink("pictures", folder.path() / "link");
  fs::create_symlink("later.tum", folder.path() / "link.tum");
  const std::vector<std::string> few = {"replay", bundled("corner"), "--frames", "0:2"};
  auto arguments = few;
  arguments.insert(arguments.end(), {"--output", video, "--poses", folder.path() / "link.tum"});
  ProgramResult result = penumbra(arguments);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_GT(fs::file_size(video), 1000U);
  EXPECT_TRUE(fs::is_symlink(folder.path() / "link.tum"));
  EXPECT_EQ(pose_count(folder.path() / "later.tum"), 2);
  arguments = few;
  arguments.insert(arguments.end(), {"--output", folder.path() / "link"});
  result = penumbra(arguments);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_TRUE(fs::is_symlink(folder.path() / "link"));
  EXPECT_EQ(contents_of(folder.path() / "pictures").size(), 2U);
}

// The nightly form replays the whole recording.
TEST(ReplayCommand, WritesSameBytesForTabletopRunTwice) {
  const TemporaryFolder folder;
  const int count = nightly() ? 120 : 6;
  for (const char* name : {"a", "b", "a.mkv", "b.mkv"}) {
    const fs::path output = folder.path() / name;
    const ProgramResult result =
        penumbra({"replay", bundled("tabletop"), "--frames", fmt::format("0:{}", count), "--output",
                  output, "--poses", output.string() + ".tum"});
    ASSERT_EQ(result.exit_code, 0) << result.err;
  }
  const auto frames = contents_of(folder.path() / "a");
  ASSERT_EQ(frames.size(), static_cast<std::size_t>(count));
  EXPECT_EQ(contents_of(folder.path() / "b"), frames);
  EXPECT_FALSE(fingerprint_of(folder.path() / "a.mkv").empty());
  EXPECT_EQ(fingerprint_of(folder.path() / "a.mkv"), fingerprint_of(folder.path() / "b.mkv"));
  const std::string poses = bytes_of(folder.path() / "a.tum");
  EXPECT_EQ(pose_count(folder.path() / "a.tum"), count);
  for (const char* other : {"b.tum", "a.mkv.tum", "b.mkv.tum"}) {
    EXPECT_EQ(bytes_of(folder.path() / other), poses) << other;
  }
}

// The output must have exactly the requested frames with their names and numbers. A replay of 0
// frames must fail.
TEST(ReplayCommand, WritesExactlyRequestedFrames) {
  const TemporaryFolder folder;
  const Replay done =
      replay(folder.path(), {bundled("tabletop"), "--frames", "57:63", "--output",
                             folder.path() / "out", "--poses", folder.path() / "out.tum"});
  ASSERT_EQ(done.result.exit_code, 0) << done.result.err;
  EXPECT_EQ(done.report["frames"], 6);
  EXPECT_EQ(done.report["accuracy"]["frames_with_truth"], 6);
  EXPECT_EQ(done.report["time_ms"]["encode"]["count"], 6);
  EXPECT_EQ(done.report["time_ms"]["readback"]["count"], 6);
  std::vector<std::string> names;
  for (const auto& [name, fingerprint] : contents_of(folder.path() / "out")) names.push_back(name);
  EXPECT_THAT(names, testing::ElementsAre("000057.png", "000058.png", "000059.png", "000060.png",
                                          "000061.png", "000062.png"));
  EXPECT_EQ(pose_count(folder.path() / "out.tum"), 6);
  expect_failure(penumbra({"replay", bundled("tabletop"), "--frames", "120:130"}),
                 {"tabletop", "0 to 119"});
}

TEST(ReplayCommand, MeasuresFramesByTrackingMode) {
  const TemporaryFolder folder;
  double rmse_detect = 0.0;
  for (const char* mode : {"detect", "fast", "accurate", "auto"}) {
    const Replay done = replay(folder.path(), {bundled("tabletop"), "--frames", "0:6", "--tracking",
                                               mode, "--scene", empty_scene_in(folder.path())});
    ASSERT_EQ(done.result.exit_code, 0) << done.result.err;
    EXPECT_EQ(done.report["frames_tracked"], 6) << mode;
    const bool detects = std::string_view(mode) == "detect";
    EXPECT_EQ(done.report["tracking"]["full_detections"], detects ? 6 : 1) << mode;
    EXPECT_EQ(done.report["tracking"]["tracked_updates"], detects ? 0 : 5) << mode;
    EXPECT_EQ(done.report["time_ms"]["detect"]["count"], detects ? 6 : 1) << mode;
    EXPECT_EQ(done.report["time_ms"]["align"]["count"], detects ? 0 : 6) << mode;
    const auto rmse = done.report["accuracy"]["overlay_px"]["rmse"].get<double>();
    if (detects) {
      rmse_detect = rmse;
    } else {
      EXPECT_LT(rmse, 0.55 * rmse_detect) << mode;
    }
  }
}

TEST(ReplayCommand, StopsSamplingWithinPoseBudget) {
  const TemporaryFolder folder;
  const auto run = [&folder](std::vector<std::string> options) {
    options.insert(options.begin(), {bundled("tabletop"), "--frames", "0:20"});
    options.insert(options.end() - 2, {"--scene", empty_scene_in(folder.path())});
    const Replay done = replay(folder.path(), options);
    EXPECT_EQ(done.result.exit_code, 0) << done.result.err;
    EXPECT_EQ(done.report["frames_tracked"], 20);
    // The report counts the frames in which pixels were skipped.
    const bool stops = std::ranges::find(options, "--pose-budget") != options.end();
    const auto& skipped = done.report["tracking"]["skipped"];
    EXPECT_EQ(skipped.contains("pixels_within_budget"), stops && options.back() != "0.000001")
        << options.back();
    EXPECT_FALSE(std::ranges::find(options, "--tracking") != options.end() &&
                 skipped.contains("pixels_while_moving"))
        << "only the mode auto uses fewer pixels while moving";
    return std::pair(done.report["tracking"]["pixels_sampled"].get<std::int64_t>(),
                     done.report["accuracy"]["overlay_px"]["rmse"].get<double>());
  };
  const Replay moving = replay(folder.path(), {bundled("tabletop"), "--frames", "0:20", "--scene",
                                               empty_scene_in(folder.path())});
  EXPECT_GT(moving.report["tracking"]["skipped"]["pixels_while_moving"], 10);
  EXPECT_FALSE(moving.report["tracking"]["skipped"].contains("pixels_within_budget"));
  const auto all = run({"--tracking", "accurate"});
  const auto fast = run({"--tracking", "fast"});
  const auto loose = run({"--pose-budget", "0.3"});
  const auto tight = run({"--pose-budget", "0.06"});
  const auto endless = run({"--pose-budget", "0.000001"});
  EXPECT_GT(fast.first, 20 * 200);
  EXPECT_LT(loose.first, fast.first * 3 / 5);
  EXPECT_LT(loose.second, 0.3);
  EXPECT_GT(tight.first, loose.first);
  EXPECT_LT(tight.second, 1.1 * loose.second);
  // With an unreachable budget all pixels are used; in the mode `fast`, at most its usual number.
  EXPECT_NEAR(static_cast<double>(endless.first), static_cast<double>(all.first),
              0.02 * static_cast<double>(all.first));
  EXPECT_LE(run({"--tracking", "fast", "--pose-budget", "0.000001"}).first, fast.first * 101 / 100);
  for (const char* wrong : {"0", "-1", "nan", "inf", "x"}) {
    const ProgramResult refused = penumbra({"replay", bundled("tabletop"), "--pose-budget", wrong});
    EXPECT_EQ(refused.exit_code, 2) << wrong;
    EXPECT_THAT(refused.err, HasSubstr("--pose-budget"));
  }
}

TEST(ReplayCommand, SmoothsDrawingButNotWrittenPoses) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  const auto run = [&](const std::string& name, const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"replay",
                                          bundled("tabletop"),
                                          "--frames",
                                          "0:5",
                                          "--no-window",
                                          "--poses",
                                          path(name.c_str()) + ".tum",
                                          "--report",
                                          path(name.c_str()) + ".json",
                                          "--output",
                                          path(name.c_str())};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const auto done = penumbra(arguments);
    EXPECT_EQ(done.exit_code, 0) << done.err;
    return test::read_json(path(name.c_str()) + ".json");
  };
  const auto plain = run("plain", {});
  const auto smooth = run("smooth", {"--smooth"});
  const auto alone = run("alone", {"--smooth", "--threads", "1"});
  EXPECT_EQ(test::bytes_of(path("plain.tum")), test::bytes_of(path("smooth.tum")));
  EXPECT_EQ(plain["accuracy"], smooth["accuracy"]);
  EXPECT_FALSE(plain.contains("smoothing"));
  const auto& smoothing = smooth["smoothing"];
  EXPECT_GE(smoothing["lag_ms"]["median"].get<double>(), 0.0);
  EXPECT_GT(smoothing["offset_px"]["max"].get<double>(), 0.0);
  EXPECT_LE(smoothing["offset_px"]["max"].get<double>(), 0.25);
  EXPECT_NEAR(smoothing["accuracy"]["overlay_px"]["rmse"].get<double>(),
              plain["accuracy"]["overlay_px"]["rmse"].get<double>(), 0.05);
  const auto plain_frames = test::contents_of(path("plain"));
  const auto smooth_frames = test::contents_of(path("smooth"));
  EXPECT_EQ(plain_frames.at("000000.png"), smooth_frames.at("000000.png"))
      << "the first frame must be drawn as measured";
  EXPECT_NE(plain_frames, smooth_frames);
  EXPECT_EQ(smooth_frames, test::contents_of(path("alone")))
      << "the number of threads must not change the frames";
  // --smooth must not change given poses.
  EXPECT_EQ(penumbra({"replay", bundled("tabletop"), "--smooth", "--poses-from", "groundtruth"})
                .exit_code,
            2);
}

TEST(ReplayCommand, SkipsTrackingForGivenPoses) {
  const TemporaryFolder folder;
  const Replay truth =
      replay(folder.path(), {bundled("tabletop"), "--frames", "10:14", "--poses-from",
                             "groundtruth", "--output", folder.path() / "truth"});
  ASSERT_EQ(truth.result.exit_code, 0) << truth.result.err;
  EXPECT_EQ(truth.report["frames_tracked"], 4);
  EXPECT_LT(truth.report["accuracy"]["overlay_px"]["max"].get<double>(), 1e-9);
  EXPECT_EQ(truth.report["tracking"]["full_detections"], 0);
  EXPECT_EQ(truth.report["time_ms"]["detect"]["count"], 0);
  EXPECT_EQ(truth.report["time_ms"]["solve"]["count"], 0);
  // Rendering from the poses of a replay must give the same images.
  const Replay tracked =
      replay(folder.path(), {bundled("tabletop"), "--frames", "10:14", "--output",
                             folder.path() / "tracked", "--poses", folder.path() / "out.tum"});
  ASSERT_EQ(tracked.result.exit_code, 0) << tracked.result.err;
  const Replay given =
      replay(folder.path(), {bundled("tabletop"), "--frames", "10:14", "--output",
                             folder.path() / "given", "--poses-from", folder.path() / "out.tum"});
  ASSERT_EQ(given.result.exit_code, 0) << given.result.err;
  EXPECT_EQ(contents_of(folder.path() / "given").size(), 4U);
  EXPECT_EQ(contents_of(folder.path() / "given"), contents_of(folder.path() / "tracked"));
  EXPECT_NE(contents_of(folder.path() / "given"), contents_of(folder.path() / "truth"));
}

TEST(ReplayCommand, DrawsEachTechniqueDifferently) {
  const TemporaryFolder folder;
  std::map<std::string, std::string> images;
  for (const std::string& technique : shadow_words_without({})) {
    const ProgramResult result =
        penumbra({"replay", bundled("tabletop"), "--frames", "30:31", "--poses-from", "groundtruth",
                  "--shadow", technique, "--output", folder.path() / technique});
    ASSERT_EQ(result.exit_code, 0) << result.err;
    const std::string image = fingerprint_of(folder.path() / technique / "000030.png");
    ASSERT_FALSE(image.empty());
    for (const auto& [other, fingerprint] : images) {
      EXPECT_NE(image, fingerprint) << technique << " and " << other;
    }
    images[technique] = image;
  }
  const ProgramResult kernels =
      penumbra({"replay", bundled("tabletop"), "--frames", "30:31", "--poses-from", "groundtruth",
                "--shadow", "layered", "--kernels", "cocl", "--output", folder.path() / "k"});
  ASSERT_EQ(kernels.exit_code, 0) << kernels.err;
  EXPECT_EQ(fingerprint_of(folder.path() / "k" / "000030.png"), images["cocl"]);
}

// The report contains the translucency mode. In each mode, skipping must not change a byte. The
// short form omits three modes for `corner`, and skipping for `auto`, whose frames equal those of
// `blend`.
TEST(ReplayCommand, AppliesAndReportsForcedTranslucency) {
  const TemporaryFolder folder;
  std::map<std::string, std::map<std::string, std::string>> frames;
  for (const std::string mode : {"auto", "blend", "mesh", "retexture", "geometry-mesh"}) {
    for (const char* recording : {"tabletop", "corner"}) {
      if (!nightly() && mode != "blend" && mode != "retexture" &&
          std::string(recording) == "corner")
        continue;
      const fs::path base = folder.path() / fmt::format("{}-{}", mode, recording);
      const auto run = [&](const std::string& name, const std::vector<std::string>& more) {
        std::vector<std::string> arguments = {
            bundled(recording), "--frames", "30:32",    "--poses-from",      "groundtruth",
            "--translucency",   mode,       "--output", base.string() + name};
        arguments.insert(arguments.end(), more.begin(), more.end());
        const Replay done = replay(folder.path(), arguments);
        EXPECT_EQ(done.result.exit_code, 0) << done.result.err;
        EXPECT_EQ(done.report["gl"]["translucency"], mode == "auto" ? "blend" : mode);
        return contents_of(base.string() + name);
      };
      const auto skipping = run("", {});
      ASSERT_EQ(skipping.size(), 2U);
      if (nightly() || mode != "auto") {
        EXPECT_EQ(run("all", {"--no-skip"}), skipping) << mode << " " << recording;
      }
      if (std::string(recording) == "tabletop") frames[mode] = skipping;
    }
  }
  EXPECT_EQ(frames["auto"], frames["blend"]);
  EXPECT_NE(frames["mesh"], frames["blend"]);
  EXPECT_NE(frames["geometry-mesh"], frames["blend"]);
  EXPECT_NE(frames["geometry-mesh"], frames["mesh"]);
}

struct NamedReplay {
  std::map<std::string, std::string> images;
  nlohmann::json report;
};
// Replays frames of `tabletop` into the folder NAME of images and the pose file NAME.tum.
NamedReplay replay_named(const TemporaryFolder& folder, const std::string& name,
                         const std::string& frames, const std::vector<std::string>& more) {
  std::vector<std::string> arguments = {
      bundled("tabletop"), "--frames",          frames, "--poses", folder.path() / (name + ".tum"),
      "--output",          folder.path() / name};
  arguments.insert(arguments.end(), more.begin(), more.end());
  const Replay done = replay(folder.path(), arguments);
  EXPECT_EQ(done.result.exit_code, 0) << done.result.err;
  return {contents_of(folder.path() / name), done.report};
}

TEST(ReplayCommand, RectifiesFramesWithoutChangingPoses) {
  const TemporaryFolder folder;
  const auto run = [&](const std::string& name, const std::vector<std::string>& more) {
    return replay_named(folder, name, "30:33", more).images;
  };
  const auto distorted = run("distorted", {});
  const auto rectified = run("rectified", {"--rectified"});
  EXPECT_EQ(rectified.size(), 3U);
  EXPECT_NE(rectified, distorted);
  EXPECT_EQ(run("all", {"--rectified", "--no-skip"}), rectified);
  // Tracking uses the original video, so the poses are the same.
  EXPECT_EQ(bytes_of(folder.path() / "rectified.tum"), bytes_of(folder.path() / "distorted.tum"));
}

// Objects are lit by the light in the video, equally for any number of threads. The poses do not
// depend on the light.
TEST(ReplayCommand, LightsObjectsWithLightOfVideo) {
  const TemporaryFolder folder;
  const auto run = [&](const std::string& name, const std::vector<std::string>& more) {
    return replay_named(folder, name, "10:13", more);
  };
  const NamedReplay lit = run("lit", {});
  EXPECT_EQ(lit.report["time_ms"]["light"]["count"], 3);
  EXPECT_EQ(run("again", {"--threads", "1"}).images, lit.images);
  const NamedReplay scene_light = run("scene-light", {"--no-video-light"});
  EXPECT_EQ(scene_light.report["time_ms"]["light"]["count"], 0);
  ASSERT_EQ(scene_light.images.size(), lit.images.size());
  for (const auto& [file, bytes] : lit.images)
    EXPECT_NE(scene_light.images.at(file), bytes) << file;
  EXPECT_EQ(bytes_of(folder.path() / "scene-light.tum"), bytes_of(folder.path() / "lit.tum"));
}

// Draws one frame of a scene with a level helicopter, with the given options.
class ReplayShadowOptions : public testing::Test {
 protected:
  ReplayShadowOptions() {
    std::ofstream(scene()) << R"({"objects":[{"name":"helicopter","position":[0,0,0.08],"model":")"
                           << model()
                           << R"("}],"lights":[{"name":"lamp","kind":"point","position":[0,0,0.7]}],
                               "shadows":[{"name":"s","technique":"layered"}]})";
  }
  [[nodiscard]] std::string scene() const { return folder_.path() / "scene.json"; }
  [[nodiscard]] std::string file(const char* name) const { return folder_.path() / name; }
  static std::string model() { return source_dir() / "scenes/models/helicopter.glb"; }
  ProgramResult replay(const std::vector<std::string>& options, const std::string& output) {
    std::vector<std::string> arguments = {
        "replay",      bundled("tabletop"), "--frames", "30:31",    "--poses-from",
        "groundtruth", "--scene",           scene(),    "--output", output};
    arguments.insert(arguments.end(), options.begin(), options.end());
    return penumbra(arguments);
  }
  // Returns the fingerprint of the frame's image.
  std::string image(const std::vector<std::string>& options) {
    const std::string output = file("frames");
    const ProgramResult result = replay(options, output);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    last_warnings_ = result.err;
    const std::string fingerprint = fingerprint_of(output + "/000030.png");
    std::filesystem::remove_all(output);
    EXPECT_FALSE(fingerprint.empty());
    return fingerprint;
  }
  TemporaryFolder folder_;
  std::string last_warnings_;
};

TEST_F(ReplayShadowOptions, ReadsKernelsFromFile) {
  const std::string automatic = image({});
  std::map<std::string, std::string> named;
  for (const std::string source : {"auto", "cocl", "smooth"}) {
    const std::string kernels = file("k.json");
    ASSERT_EQ(penumbra({"kernels", model(), "--kernels", source, "--output", kernels}).exit_code,
              0);
    named[source] = image({"--kernels", source});
    EXPECT_EQ(last_warnings_, "");
    EXPECT_EQ(image({"--kernels", kernels}), named[source]) << source;
    EXPECT_EQ(last_warnings_, "");
  }
  EXPECT_EQ(named["auto"], automatic);
  EXPECT_NE(named["cocl"], automatic);
  // If neither the scene nor --shadow selects a technique, the kernels of --kernels are used even
  // if their kind differs from the node's.
  EXPECT_NE(image({"--kernels", "per-axis"}), named["cocl"]);
}

// If a technique needs a light that the scene lacks, the program warns once for all frames.
TEST_F(ReplayShadowOptions, WarnsOnceOfMissingLight) {
  std::ofstream(scene()) << R"({"objects":[{"name":"helicopter","position":[0,0,0.08],"model":")"
                         << model() << R"("}],"shadows":[{"name":"s","technique":"layered"}]})";
  for (const char* technique : {"hard", "volume"}) {
    const ProgramResult warned =
        penumbra({"replay", bundled("tabletop"), "--frames", "30:33", "--poses-from", "groundtruth",
                  "--scene", scene(), "--shadow", technique, "--output", file("warned")});
    EXPECT_EQ(warned.exit_code, 0);
    EXPECT_EQ(lines_of(warned.err).size(), 1U) << warned.err;
    EXPECT_NE(warned.err.find("no shadow: s: the scene has no light"), std::string::npos)
        << warned.err;
  }
  image({"--shadow", "layered"});
  EXPECT_EQ(last_warnings_, "");
}

// The warning names the option and the technique. An option with an effect gives no warning.
TEST_F(ReplayShadowOptions, WarnsOfOptionsWithoutEffect) {
  using Words = std::vector<std::string>;
  std::map<std::string, std::string> without_option;  // technique -> image
  for (const auto& [technique, words] :
       std::vector<std::pair<std::string, Words>>{{"hard", {"--kernels", "smooth"}},
                                                  {"simple", {"--kernels", "cocl"}},
                                                  {"volume", {"--light-mode", "fixed"}},
                                                  {"field", {"--light-mode", "proportional"}},
                                                  {"field", {"--proxy", "auto"}}}) {
    Words with = {"--shadow", technique};
    with.insert(with.end(), words.begin(), words.end());
    const std::string with_option = image(with);
    ASSERT_EQ(lines_of(last_warnings_).size(), 1U) << words[0] << ": " << last_warnings_;
    EXPECT_NE(last_warnings_.find(words[0] + ": has no effect with " + technique + " shadows"),
              std::string::npos)
        << last_warnings_;
    if (!without_option.contains(technique)) {
      without_option[technique] = image({"--shadow", technique});
      EXPECT_EQ(last_warnings_, "");
    }
    EXPECT_EQ(with_option, without_option[technique]) << words[0] << " must have no effect";
  }
  for (const Words& of_use :
       {Words{"--shadow", "layered", "--kernels", "smooth"},
        Words{"--shadow", "layered", "--light-mode", "fixed"},
        Words{"--shadow", "field", "--light-mode", "fixed"},
        Words{"--shadow", "hard", "--kernels", "auto"}, Words{"--kernels", "smooth"}}) {
    image(of_use);
    EXPECT_EQ(last_warnings_, "") << of_use[1];
  }
}

TEST_F(ReplayShadowOptions, ReportsMismatchedKernels) {
  const auto with = [&](const std::string& text) {
    std::ofstream(file("k.json"), std::ios::binary) << text;
    return replay({"--kernels", file("k.json")}, file("frames"));
  };
  expect_failure(with(R"({"kernels": [0,0,0, 1,1,1], "up": [0,0,1]})"),
                 {"k.json", "2 triples", "helicopter"});
  expect_failure(with("{"), {"k.json"});
  expect_failure(replay({"--kernels", file("none.json")}, file("frames")), {"none.json"});
  EXPECT_FALSE(std::filesystem::exists(file("frames")));
  // Kernels of another shape with the same number of vertices.
  ASSERT_EQ(penumbra({"kernels", model(), "--output", file("k.json")}).exit_code, 0);
  std::string text = bytes_of(file("k.json"));
  const std::size_t key = text.find("\"geometry\":\"") + 12;
  text[key] = text[key] == '0' ? '1' : '0';
  std::ofstream(file("k.json"), std::ios::binary) << text;
  EXPECT_EQ(image({"--kernels", file("k.json")}), image({}));
}

TEST_F(ReplayShadowOptions, AppliesFixedLightMode) {
  const std::string proportional = image({});
  EXPECT_EQ(image({"--light-mode", "proportional"}), proportional);
  const std::string fixed = image({"--light-mode", "fixed"});
  EXPECT_NE(fixed, proportional);
  EXPECT_EQ(image({"--light-mode", "fixed", "--no-skip"}), fixed);
}

TEST(ReplayCommand, KeepsReadableFilesOnCtrlC) {
  const TemporaryFolder folder;
  const ProgramResult result = run_program(
      program(),
      {"replay", bundled("tabletop"), "--realtime", "--output", folder.path() / "out", "--poses",
       folder.path() / "out.tum", "--report", folder.path() / "report.json"},
      {}, {}, [&](pid_t child) {
        // Waits for the first images; gives up after a minute.
        for (int i = 0; i < 6000; ++i) {
          const fs::path partial = folder.path() / ("out.partial-" + std::to_string(child) + "-0");
          if (fs::exists(partial / "000002.png")) break;
          std::this_thread::sleep_for(std::chrono::milliseconds(10));
        }
        kill(child, SIGINT);
      });
  EXPECT_EQ(result.exit_code, 0) << result.err;
  const nlohmann::json report = read_json(folder.path() / "report.json");
  ASSERT_TRUE(report.is_object());
  EXPECT_EQ(report["interrupted"], true);
  const int frames = report["frames"].get<int>();
  EXPECT_GE(frames, 2);
  EXPECT_LT(frames, 120);
  EXPECT_EQ(contents_of(folder.path() / "out").size(), static_cast<std::size_t>(frames));
  EXPECT_EQ(pose_count(folder.path() / "out.tum"), report["frames_tracked"].get<int>());
  EXPECT_EQ(contents_of(folder.path()).size(), 3U) << "a partial file was left";
}

// The true poses are read from a pipe without a writer, so the setup blocks as long as the test
// wants.
TEST(ReplayCommand, StopsSetupOnSignalAndLeavesNoFile) {
  for (const int number : {SIGINT, SIGTERM}) {
    const TemporaryFolder folder;
    const fs::path recording = folder.path() / "recording";
    fs::copy(bundled("corner"), recording, fs::copy_options::recursive);
    const fs::path pipe = recording / "groundtruth.tum";
    fs::remove(pipe);
    ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
    const fs::path out = folder.path() / "results";
    fs::create_directory(out);
    const ProgramResult result =
        run_program(program(),
                    {"replay", recording, "--output", out / "out.mkv", "--poses", out / "out.tum",
                     "--report", out / "report.json"},
                    {}, {}, [&](pid_t child) {
                      int writer = -1;
                      for (int i = 0; i < 6000 && writer < 0; ++i) {  // until the program opens it
                        writer = open(pipe.c_str(), O_WRONLY | O_NONBLOCK | O_CLOEXEC);
                        if (writer < 0) std::this_thread::sleep_for(std::chrono::milliseconds(10));
                      }
                      kill(child, number);
                      // Unblocks a program that ignores the signal; the test then fails because of
                      // the exit code.
                      siginfo_t info{};
                      for (int i = 0; i < 1000 && info.si_pid == 0; ++i) {
                        waitid(P_PID, static_cast<id_t>(child), &info, WEXITED | WNOHANG | WNOWAIT);
                        std::this_thread::sleep_for(std::chrono::milliseconds(10));
                      }
                      if (writer >= 0) close(writer);
                    });
    EXPECT_EQ(result.exit_code, 128 + number) << result.err;
    EXPECT_TRUE(fs::is_empty(out));
  }
}

// MESA_GL_VERSION_OVERRIDE disables OpenGL 3.3, which a Raspberry Pi 4 also lacks.
TEST(ReplayCommand, FallsBackToOpenGlEs) {
  const TemporaryFolder folder;
  const ProgramResult result =
      penumbra({"replay", bundled("corner"), "--frames", "0:2", "--output", folder.path() / "out",
                "--report", folder.path() / "report.json"},
               {"MESA_GL_VERSION_OVERRIDE=3.1"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const nlohmann::json report = read_json(folder.path() / "report.json");
  EXPECT_THAT(report["gl"]["version"].get<std::string>(), HasSubstr("OpenGL ES 3"));
  EXPECT_EQ(contents_of(folder.path() / "out").size(), 2U);
}

TEST(ReplayCommand, LogsFramesOnlyAtDebugLevel) {
  const std::vector<std::string> arguments = {"replay", bundled("corner"), "--frames", "0:2",
                                              "--log-level"};
  auto with = [&](const char* level) {
    std::vector<std::string> all = arguments;
    all.emplace_back(level);
    return penumbra(all);
  };
  EXPECT_EQ(with("warning").err, "");
  const ProgramResult info = with("info");
  EXPECT_THAT(info.err, testing::AllOf(HasSubstr("info: OpenGL: "), HasSubstr("info: penumbra ")));
  EXPECT_THAT(info.err, testing::Not(HasSubstr("frame 0")));
  const ProgramResult debug = with("debug");
  EXPECT_THAT(debug.err, testing::AllOf(HasSubstr("debug: frame 0: tracked"),
                                        HasSubstr("debug: frame 1: tracked")));
}

TEST(ReplayCommand, WritesSameFramesWithWindow) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  const fs::path with_display = test::source_dir() / "tests/support/with-display";
  const TemporaryFolder folder;
  const auto arguments = [&](const std::string& name) {
    return std::vector<std::string>{"replay", bundled("corner"), "--frames",
                                    "0:3",    "--output",        folder.path() / name};
  };
  std::vector<std::string> in_window = {program().string()};
  for (const std::string& argument : arguments("window")) in_window.push_back(argument);
  const ProgramResult window = run_program(with_display, in_window);
  ASSERT_EQ(window.exit_code, 0) << window.err;
  EXPECT_THAT(window.out, testing::Not(HasSubstr("offscreen")));
  const ProgramResult offscreen = penumbra(arguments("offscreen"));
  ASSERT_EQ(offscreen.exit_code, 0) << offscreen.err;
  EXPECT_EQ(contents_of(folder.path() / "window").size(), 3U);
  EXPECT_EQ(contents_of(folder.path() / "window"), contents_of(folder.path() / "offscreen"));
}

// Counters in the report show that kernels and layers are recomputed only if necessary.
TEST(ReplayCommand, ComputesKernelsOnceForStillOrSlidingObjects) {
  const TemporaryFolder folder;
  struct Case {
    std::string name;
    std::string placement;  // JSON keys of the object
    int recomputed, reprojected, moved;
  };
  const auto from_to = [](const std::string& from, const std::string& to) {
    return R"("animation": {"interpolation": "linear", "keyframes": [)"
           R"({"time_s": 0, "position": )" +
           from + R"(}, {"time_s": 100, "position": )" + to + "}]}";
  };
  for (const Case& c : {Case{"stays", R"("position": [0.1, 0.1, 0.1])", 1, 19, 0},
                        Case{"slides", from_to("[0, 0, 0.1]", "[0.2, 0.1, 0.1]"), 1, 19, 19},
                        Case{"rises", from_to("[0, 0, 0.05]", "[0, 0, 0.2]"), 20, 0, 19}}) {
    SCOPED_TRACE(c.name);
    std::ofstream(folder.path() / "scene.json")
        << R"({"name": "box", "objects": [{"name": "box", "shape": {"kind": "box", )"
           R"("size": [0.06, 0.06, 0.06]}, )"
        << c.placement
        << R"(}], "shadows": [{"name": "layers", "technique": "layered", "casters": ["box"], )"
           R"("planes": ["table"]}]})";
    const Replay done = replay(folder.path(), {bundled("tabletop"), "--frames", "0:20", "--scene",
                                               folder.path() / "scene.json"});
    ASSERT_EQ(done.result.exit_code, 0) << done.result.err;
    ASSERT_EQ(done.report["frames_tracked"], 20);
    const nlohmann::json& work = done.report["work"];
    EXPECT_EQ(work["kernel_generations"], 1);
    EXPECT_EQ(work["triples_recomputed"], c.recomputed);
    EXPECT_EQ(work["reprojections"], c.reprojected);
    EXPECT_EQ(work["object_moved"], c.moved);
    EXPECT_EQ(work["object_rotated"], 0);
    EXPECT_EQ(work["plane_moved"], 0);
  }
}

TEST(ReplayCommand, ContinuesOffscreenWithoutDisplay) {
  const ProgramResult result =
      run_program(program(), {"replay", bundled("corner"), "--frames", "0:2"}, {"DISPLAY=:987"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(result.err, "");
  EXPECT_THAT(lines_of(result.out).at(0), HasSubstr("going on offscreen"));
}

TEST(DemoCommand, WritesVideo) {
  const TemporaryFolder folder;
  const ProgramResult result = run_program(program(), {"demo"}, {}, folder.path());
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const std::vector<std::string> lines = lines_of(result.out);
  ASSERT_FALSE(lines.empty());
  const fs::path video = fs::canonical(folder.path()) / "penumbra-demo.mp4";
  EXPECT_EQ(lines.back(), "video: " + video.string());
  EXPECT_GT(fs::file_size(video), 10'000U);
  EXPECT_THAT(result.out, HasSubstr("overlay [px]"));
  EXPECT_THAT(result.out, HasSubstr("120 frames"));
}

}  // namespace
}  // namespace penumbra::test
